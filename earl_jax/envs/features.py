"""What only some tasks have, and what has a default: a map of visits, further starts, pictures, the continuing setting."""

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

    `position(obs [..., s + g])` returns x, y [..., 2] of the body that the map tracks. `bounds [2, 2]` are [x, y] low and
    [x, y] high, in `unit`. `starts [K, 2]` stand for the initial distribution, and at `goals [K, 2]` a goal is reached;
    None if the task lists none.
    """

    position: Callable[[jax.Array], jax.Array]
    bounds: np.ndarray
    unit: str = "m"
    starts: np.ndarray | None = None
    goals: np.ndarray | None = None


@dataclasses.dataclass(frozen=True)
class Starts:
    """Distributions of starts beside s0 ~ rho, functions like `reset`; None for a task without.

    `uniform(key)` draws over the whole workspace (figure 4 of the paper). `wide(key)` is that of `deployed/success_wide`:
    about half of its starts or more lie where no demonstration begins, in places that the agent could reach by itself.
    A task whose reward is dense has no wide starts, because its score is a return. A task whose rho is uniform over `count`
    starts has `numbered(key, number)`, which returns the one with that number; evaluations can balance them.
    """

    uniform: Callable[[jax.Array], State] | None = None
    wide: Callable[[jax.Array], State] | None = None
    numbered: Callable[[jax.Array, jax.Array], State] | None = None
    count: int = 1

    def __post_init__(self):
        """Give all functions the package's types, as `Env.reset` and `Env.step` have them."""
        for name, start in self.functions.items():
            object.__setattr__(self, name, package_types()(start))

    @property
    def functions(self) -> dict[str, Callable[..., State]]:
        """The functions that the task has, by name."""
        every = {"uniform": self.uniform, "wide": self.wide, "numbered": self.numbered}
        return {name: start for name, start in every.items() if start is not None}


class View(NamedTuple):
    """How a task is drawn.

    `model` is its MJCF: a name in assets, or a path. A control step takes `dt` seconds in videos. `render_state(state)`
    returns the `PhysicsState` of `model` that shows `state`, by default its `data`, and `render_goal(state)` the one that
    reaches its goal, or None.
    """

    model: str
    dt: float = 0.1
    render_state: Callable[[State], Any] = operator.attrgetter("data")
    render_goal: Callable[[State], Any] = lambda state: None


class ContinuingDefaults(NamedTuple):
    """The numbers of a task in the paper's continuing setting.

    `goal_change`: steps between goal changes. `train_horizon`: H_T of the released lifelong configuration, 0 for never;
    None if it is that of the task.
    """

    goal_change: int
    train_horizon: int | None = None
