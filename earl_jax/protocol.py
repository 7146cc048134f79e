"""The ARL formalism around a task: when the world is touched by hand, who asks for what, and how a life is judged.

Source: Sharma et al. 2022, section 3; numbers of the settings follow the released code. docs/formalism.md says it in equations.
"""

import dataclasses
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.envs import Env
from earl_jax.envs.helped import Helped
from earl_jax.options import check

HELP = ("budget", "help_cost", "enforced_cost", "help_above", "absorbed_reward")
"""The fields that a `Setting` and a `Helped` world have in common."""


class Rules(NamedTuple):
    """When the world of one life is touched from outside, as data: lanes of one program may differ in it.

    Int32 `horizon []`: steps between hard interventions, 0 for never; float32 `chance []` of one at any step; int32
    `goal_change []`: steps between goals that the world asks for, 0 where every new attempt draws its own.
    """

    horizon: Any
    chance: Any
    goal_change: Any

    def intervened(self, steps_lived: jax.Array, key: jax.Array) -> jax.Array:
        """Return whether a hard intervention follows the `steps_lived`-th step of a life, bool []."""
        return _every(steps_lived, self.horizon) | (jax.random.uniform(key) < self.chance)

    def goal_changes(self, steps_lived: jax.Array) -> jax.Array:
        """Return whether the world asks for another goal after the `steps_lived`-th step of a life, bool []."""
        return _every(steps_lived, self.goal_change)


def _every(steps_lived: jax.Array, period: jax.Array) -> jax.Array:
    return (period > 0) & (steps_lived % jnp.maximum(period, 1) == 0)


@dataclasses.dataclass(frozen=True)
class Protocol:
    """How a life is lived and judged: interventions, goals, and evaluations of the greedy task policy from s0 ~ rho."""

    train_horizon: int
    """H_T: steps between hard interventions, which put the world back to s0 ~ rho; 0 for never."""
    eval_horizon: int
    """H_E: steps of an evaluation episode."""
    eval_every: int = 10_000
    """Training steps between deployed evaluations."""
    eval_episodes: int = 10
    """Episodes of one deployed evaluation."""
    intervention_chance: float = 0.0
    """epsilon: probability that a step is followed by a hard intervention, p~ = (1 - epsilon) p + epsilon rho."""
    goal_change: int = 0
    """Steps between goal changes of the continuing setting; 0 where every new attempt draws its goal from p_g."""

    def __post_init__(self):
        for field in ("eval_horizon", "eval_every", "eval_episodes"):
            if getattr(self, field) < 1:
                raise ValueError(f"{field} must be at least 1, not {getattr(self, field)}")
        for field in ("train_horizon", "goal_change"):
            if getattr(self, field) < 0:
                raise ValueError(f"{field} must be at least 1, or 0 for never, not {getattr(self, field)}")
        if not 0 <= self.intervention_chance < 1:
            raise ValueError(f"intervention_chance must lie in [0, 1), not {self.intervention_chance}")

    @property
    def rules(self) -> Rules:
        """What of this a lane carries as data, scalars."""
        return Rules(np.int32(self.train_horizon), np.float32(self.intervention_chance), np.int32(self.goal_change))


@dataclasses.dataclass(frozen=True)
class Setting:
    """What a life is for, and what may touch it; where a field is None the task's own number holds."""

    intervention_chance: float = 0.0
    """epsilon: probability a step of a hard intervention, besides the one every H_T steps."""
    budget: float | None = None
    """h_max: what interventions may cost in all; the agent sees what is left and can ask for help (`Helped`). None: neither."""
    help_cost: float = 1.0
    """c(s, a_h): what asking for help costs, where there is a budget."""
    enforced_cost: float = 1.0
    """What an intervention costs that the environment enforces in an irreversible state, where there is a budget."""
    help_above: float = 0.98
    """What the last component of an action must pass to ask for help, where there is a budget."""
    absorbed_reward: float = 0.0
    """What every step earns once the budget is spent."""

    name: ClassVar[str]

    def world(self, task: Env) -> Env:
        """Return `task`, with help and its budget where this setting has one."""
        if self.budget is None:
            return task
        return Helped(task=task, **{name: getattr(self, name) for name in HELP})

    def protocol(self, env: Env, eval_every: int = 10_000, eval_episodes: int = 10) -> Protocol:
        """Return the protocol of a life in `env`."""
        return Protocol(env.train_horizon, env.eval_horizon, eval_every, eval_episodes, self.intervention_chance)


@dataclasses.dataclass(frozen=True)
class Deployment(Setting):
    """A life whose worth is the policy it leads to: every attempt draws its goal, hard interventions come every H_T steps.

    Judged by D(A), the area under the deployed curve, and by J_D of the final policy (section 3.1.1 of the paper).
    """

    name: ClassVar[str] = "deployment"


@dataclasses.dataclass(frozen=True)
class Continuing(Setting):
    """A life whose worth is what it earns: the world asks for one goal after another, whatever the agent is doing.

    Judged by C(A), the reward averaged over the lifetime (section 3.1.2). Goals change as in the released code, H_T is that of
    its lifelong configuration. An attempt at the task that a goal change interrupts ends there as at a time-out; a way
    back goes on. The paper's Table 2 was made from deployment runs (its reward rates can only be earned by drawing a new goal at
    each success), so `earl-jax reproduce table2` reads C(A) there.
    """

    goal_change: int | None = None
    """Steps between goal changes; None for the task's own."""

    name: ClassVar[str] = "continuing"

    def protocol(self, env: Env, eval_every: int = 10_000, eval_episodes: int = 10) -> Protocol:
        """Return the protocol of a life in `env`: a `train_horizon` that was asked for holds, else the lifelong one."""
        task, _ = settled(env, self)
        asked = task.train_horizon != type(task).train_horizon
        horizon = task.train_horizon if asked else task.continuing_horizon or task.train_horizon
        change = env.goal_change if self.goal_change is None else self.goal_change
        return Protocol(horizon, env.eval_horizon, eval_every, eval_episodes, self.intervention_chance, change)


SETTINGS: dict[str, type[Setting]] = {setting.name: setting for setting in (Deployment, Continuing)}


def setting_of(name: str = Deployment.name, **options: Any) -> Setting:
    """Return the setting `name` with its `options`.

    Raises:
        ValueError: the name or an option is unknown or of another kind; the message lists the choices.
    """
    if not isinstance(name, str) or name not in SETTINGS:
        raise ValueError(f"unknown setting {name!r}; choose from {', '.join(SETTINGS)}")
    check(f"setting {name!r}", SETTINGS[name], options)
    return SETTINGS[name](**options)


def settled(env: Env, setting: Setting) -> tuple[Env, Setting]:
    """Return the plain task of `env` and the setting that says of it what a `Helped` one said."""
    if not isinstance(env, Helped):
        return env, setting
    return env.task, dataclasses.replace(setting, **{name: getattr(env, name) for name in HELP})
