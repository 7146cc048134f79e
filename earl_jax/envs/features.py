"""Features that a task may have: a map of visits, further starts, pictures, numbers of the continuing setting."""

import dataclasses
import operator
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np

from earl_jax.envs.state import State
from earl_jax.options.jax_settings import package_types


class Map(NamedTuple):
    """The map of visited positions of a task.

    `position(obs [..., s + g])` returns x, y [..., 2] of the body that the map tracks. `bounds [2, 2]` are [x, y] low
    and [x, y] high, in `unit`. `starts [K, 2]` represent the initial distribution, and `goals [K, 2]` are positions at
    which a goal is reached; either is None if the task does not list any.
    """

    position: Callable[[jax.Array], jax.Array]
    bounds: np.ndarray
    unit: str = "m"
    starts: np.ndarray | None = None
    goals: np.ndarray | None = None


@dataclasses.dataclass(frozen=True)
class Starts:
    """Further distributions of starts besides s0 ~ rho, as functions like `reset`; None where the task has none.

    `uniform(key)` draws over the whole workspace (figure 4 of the paper). `wide(key)` draws the starts of the metric
    `deployed/success_wide`: at least about half of them lie where no demonstration begins, but where the agent could
    get by itself. Tasks with a dense reward have no wide starts, because their score is a return. If rho is uniform
    over `count` starts, `numbered(key, number)` returns start `number`, and evaluations can balance the starts.
    """

    uniform: Callable[[jax.Array], State] | None = None
    wide: Callable[[jax.Array], State] | None = None
    numbered: Callable[[jax.Array, jax.Array], State] | None = None
    count: int = 1

    def __post_init__(self):
        """Run all functions under the package's jax types, as `Env.reset` and `Env.step` are."""
        for name, start in self.functions.items():
            object.__setattr__(self, name, package_types()(start))

    @property
    def functions(self) -> dict[str, Callable[..., State]]:
        """The functions that the task has, by name."""
        every = {"uniform": self.uniform, "wide": self.wide, "numbered": self.numbered}
        return {name: start for name, start in every.items() if start is not None}


class View(NamedTuple):
    """How a task is drawn.

    `model` is the MJCF to draw: a name in assets, or a path. A control step takes `dt` seconds in videos.
    `render_state(state)` returns the `PhysicsState` of `model` that shows `state`, by default `state.data`.
    `render_goal(state)` returns the `PhysicsState` that shows the goal reached, or None to draw no goal.
    """

    model: str
    dt: float = 0.1
    render_state: Callable[[State], Any] = operator.attrgetter("data")
    render_goal: Callable[[State], Any] = lambda state: None


class ContinuingDefaults(NamedTuple):
    """The numbers of a task in the paper's continuing setting.

    `goal_change`: steps between goal changes. `train_horizon`: H_T of the released lifelong configuration, 0 for never;
    None for the `train_horizon` of the task.
    """

    goal_change: int
    train_horizon: int | None = None
