"""The two settings of the paper, deployment and continuing, which determine interventions and goals.

Source: Sharma et al. 2022, section 4; the numbers follow the released code.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any, ClassVar

from earl_jax.envs import Env
from earl_jax.envs.help_budget import HelpBudget, without_budget
from earl_jax.errors import InputError, require_known
from earl_jax.options.schedule import Schedule
from earl_jax.options.values import COUNT, COUNT_OR_NEVER, check, check_intervals, require_object, within
from earl_jax.protocol.rules import Protocol

HELP_FIELDS = ("budget", "help_cost", "enforced_cost", "help_above", "absorbed_reward")
"""The fields that `Setting` and `HelpBudget` have in common."""


def _as_in_help_budget(name: str, **changes: Any) -> Any:
    """Return a field with the default and the interval that `HelpBudget` has, or with `changes`."""
    [field] = [field for field in dataclasses.fields(HelpBudget) if field.name == name]
    return dataclasses.field(**{"default": field.default, "metadata": field.metadata, **changes})


@dataclasses.dataclass(frozen=True)
class Setting:
    """The criterion of evaluation and the interventions; a field that is None takes the task's own value."""

    intervention_chance: float = dataclasses.field(default=0.0, metadata=within("[0, 1]"))
    """epsilon: probability of a hard intervention after a step, in addition to the one every H_T steps. With 0 and
    `train_horizon=0` of the task there is none: full autonomy. Numbers of float32 are drawn, which are multiples of 1.2e-7."""
    budget: float | None = _as_in_help_budget("budget", default=None)
    """h_max: the largest total cost of interventions. The agent observes the remaining budget and can request help
    (`HelpBudget`). None: no help."""
    help_cost: float = _as_in_help_budget("help_cost")
    """c(s, a_h): cost of a request for help, with a budget."""
    enforced_cost: float = _as_in_help_budget("enforced_cost")
    """Cost of an intervention that the environment enforces in an irreversible state, with a budget."""
    help_above: float = _as_in_help_budget("help_above")
    """Threshold on the last action component above which the agent requests help, with a budget."""
    absorbed_reward: float = _as_in_help_budget("absorbed_reward")
    """Reward of every step after the budget is spent."""
    alive_steps: int = dataclasses.field(default=Protocol.alive_steps, metadata=within(COUNT))
    """Steps within which a lane that is alive reaches the goals of its phases, for the metric `continuing/alive`."""
    eval_pairs: str = Protocol.eval_pairs
    """How deployed evaluations draw pairs of start and task goal: each at `random` (released), or `balanced`, every pair
    equally often."""

    name: ClassVar[str]

    def __post_init__(self):
        check_intervals("setting", self)

    def wrap(self, task: Env) -> Env:
        """Return `task`, wrapped in a `HelpBudget` if this setting has a budget."""
        if self.budget is None:
            return task
        return HelpBudget(task=task, **{name: getattr(self, name) for name in HELP_FIELDS})

    def protocol(
        self, env: Env, eval_every: int = Schedule.eval_every, eval_episodes: int = Schedule.eval_episodes
    ) -> Protocol:
        """Return the protocol of a lifetime in `env`.

        Raises:
            ValueError: the setting has a budget, and `env` was not wrapped in its `HelpBudget`.
        """
        require_object("task", env, Env, or_name=False)
        if self.budget is not None and not isinstance(env, HelpBudget):
            raise InputError(f"the setting has a budget, but {env.name} was not wrapped in it: pass setting.wrap(env)")
        return Protocol(
            **self._intervals(env),
            eval_horizon=env.eval_horizon,
            eval_every=eval_every,
            eval_episodes=eval_episodes,
            intervention_chance=self.intervention_chance,
            alive_steps=self.alive_steps,
            eval_pairs=self.eval_pairs,
        )

    def _intervals(self, env: Env) -> dict[str, int]:
        """Return H_T and the steps between goal changes in `env`, where they are not those of a `Protocol`."""
        return {"train_horizon": env.train_horizon}


@dataclasses.dataclass(frozen=True)
class Deployment(Setting):
    """Deployment: the final policy is evaluated. Attempts draw their goals; hard interventions follow every H_T steps.

    Evaluated by D(A), the area under the deployed curve, and by J_D of the final policy (section 4.1.1 of the paper).
    """

    name: ClassVar[str] = "deployment"


@dataclasses.dataclass(frozen=True)
class Continuing(Setting):
    """Continuing: the reward of the lifetime is evaluated. The environment sets its goals independently of the agent.

    Evaluated by C(A), the reward averaged over the lifetime (section 4.1.2). Goals change as in the released code, and
    H_T is that of its lifelong configuration. A goal change ends an attempt at the task as a time-out does; a return
    phase continues. The paper's Table 2 was made from deployment runs: its reward rates require that each success draws
    a new goal. So `earl-jax reproduce table2` reads C(A) from deployment runs.
    """

    goal_change: int | None = dataclasses.field(default=None, metadata=within(COUNT))
    """Steps between goal changes; None for the task's own."""
    train_horizon: int | None = dataclasses.field(default=None, metadata=within(COUNT_OR_NEVER))
    """H_T, 0 for never; None for the lifelong H_T, or for the task's `train_horizon` if that is not its default."""

    name: ClassVar[str] = "continuing"

    def _intervals(self, env: Env) -> dict[str, int]:
        goal_change = env.continuing.goal_change if self.goal_change is None else self.goal_change
        return {"train_horizon": self._horizon(without_budget(env)), "goal_change": goal_change}

    def _horizon(self, task: Env) -> int:
        if self.train_horizon is not None:
            return self.train_horizon
        explicit, lifelong = task.train_horizon != type(task).train_horizon, task.continuing.train_horizon
        return task.train_horizon if explicit or lifelong is None else lifelong


SETTINGS: dict[str, type[Setting]] = {setting.name: setting for setting in (Deployment, Continuing)}


def setting_of(name: str | Setting = Deployment.name, **options: Any) -> Setting:
    """Return the setting `name` with its `options`, or a setting as it is.

    Raises:
        ValueError: the name or an option is unknown, or an option has a wrong type; the message lists the choices.
    """
    if isinstance(name, Setting):
        return name
    require_object("setting", name, Setting)
    require_known("setting", name, SETTINGS)
    check(f"setting {name!r}", SETTINGS[name], options)
    return SETTINGS[name](**options)


def with_explicit_horizon(setting: Setting, task: Env, options: Mapping[str, Any]) -> Setting:
    """Return `setting` with the `train_horizon` of the task's `options`, if only the setting can hold it.

    A value that equals the task's default cannot be told from the default in `task`.
    """
    asked = options.get("train_horizon")
    if not isinstance(setting, Continuing) or setting.train_horizon is not None or asked != type(task).train_horizon:
        return setting
    return dataclasses.replace(setting, train_horizon=asked)


def split_setting(env: Env, setting: Setting) -> tuple[Env, Setting]:
    """Return the plain task of `env`, and `setting` with the options of its `HelpBudget`, if it has one.

    Raises:
        ValueError: the setting has a budget with other options.
    """
    if not isinstance(env, HelpBudget):
        return env, setting
    merged = dataclasses.replace(setting, **{name: getattr(env, name) for name in HELP_FIELDS})
    if setting.budget is not None and setting != merged:
        raise InputError("the task is a HelpBudget, and the setting has another budget: leave out one of the two")
    return env.task, merged
