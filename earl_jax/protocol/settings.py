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
    """Return a field with the default and the interval of the `HelpBudget` field `name`, updated by `changes`."""
    [field] = [field for field in dataclasses.fields(HelpBudget) if field.name == name]
    return dataclasses.field(**{"default": field.default, "metadata": field.metadata, **changes})


@dataclasses.dataclass(frozen=True)
class Setting:
    """The interventions of a lifetime, an optional budget for help, and the criterion of evaluation."""

    intervention_chance: float = dataclasses.field(default=0.0, metadata=within("[0, 1]"))
    """epsilon: probability of a hard intervention after a step, in addition to those every H_T steps. With 0, and with
    `train_horizon=0` of the task, there are none: full autonomy. The draws are float32 multiples of 1.2e-7."""
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
    """Reward of every step after the budget for help is spent."""
    alive_steps: int = dataclasses.field(default=Protocol.alive_steps, metadata=within(COUNT))
    """Steps within which a lane must reach the goals of its phases to count as alive (metric `continuing/alive`)."""
    eval_pairs: str = Protocol.eval_pairs
    """How deployed evaluations draw pairs of start and task goal: each pair at `random` (released), or all equally
    often (`balanced`)."""

    name: ClassVar[str]

    def __post_init__(self):
        check_intervals("setting", self)

    def wrap(self, task: Env) -> Env:
        """Return `task`, wrapped in a `HelpBudget` if this setting has a budget, else as it is."""
        if self.budget is None:
            return task
        return HelpBudget(task=task, **{name: getattr(self, name) for name in HELP_FIELDS})

    def protocol(
        self, env: Env, eval_every: int = Schedule.eval_every, eval_episodes: int = Schedule.eval_episodes
    ) -> Protocol:
        """Return the protocol of a lifetime in `env`.

        Raises:
            ValueError: the setting has a budget, but `env` is not wrapped in the `HelpBudget` (see `wrap`).
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
        """Return H_T and the steps between goal changes in `env`, as far as they are not the defaults of `Protocol`."""
        return {"train_horizon": env.train_horizon}


@dataclasses.dataclass(frozen=True)
class Deployment(Setting):
    """Deployment: the final policy is evaluated. Each attempt draws a goal; hard interventions occur every H_T steps.

    Evaluated by the deployed curve, whose regret is D(A), and by J_D of the final policy (section 4.1.1 of the paper).
    """

    name: ClassVar[str] = "deployment"


@dataclasses.dataclass(frozen=True)
class Continuing(Setting):
    """Continuing: the reward of the lifetime is evaluated. The environment sets its goals independently of the agent.

    Evaluated by C(A), the reward averaged over the lifetime (section 4.1.2). Goals change as in the released code, and
    H_T is that of its lifelong configuration. A goal change ends an attempt at the task like a time-out; a return phase
    continues. The paper's Table 2 was made from deployment runs: its reward rates require that each success
    draws a new goal. `earl-jax reproduce table2` therefore reads C(A) from deployment runs.
    """

    goal_change: int | None = dataclasses.field(default=None, metadata=within(COUNT))
    """Steps between goal changes; None for the task's own value."""
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
    """Return the setting `name` with its `options`; a `Setting` object is returned as it is.

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
    """Return `setting` with the `train_horizon` of the task's `options` if that equals the task's default.

    `task` itself cannot show that such a value was given. `Continuing` would replace a default by the lifelong H_T.
    """
    asked = options.get("train_horizon")
    if not isinstance(setting, Continuing) or setting.train_horizon is not None or asked != type(task).train_horizon:
        return setting
    return dataclasses.replace(setting, train_horizon=asked)


def split_setting(env: Env, setting: Setting) -> tuple[Env, Setting]:
    """Return the plain task of `env`, and `setting` with the options of the `HelpBudget` if `env` is one.

    Raises:
        ValueError: `env` is a `HelpBudget`, and the setting has a budget with other options.
    """
    if not isinstance(env, HelpBudget):
        return env, setting
    merged = dataclasses.replace(setting, **{name: getattr(env, name) for name in HELP_FIELDS})
    if setting.budget is not None and setting != merged:
        raise InputError("the task is a HelpBudget, and the setting has another budget: leave out one of the two")
    return env.task, merged
