"""The demonstrations of a task: recorded ones, a scripted expert, and the script that records them."""

import dataclasses
from collections.abc import Callable, Iterator
from typing import NamedTuple

import jax
import numpy as np

from earl_jax import assets
from earl_jax.envs.state import State
from earl_jax.errors import InputError
from earl_jax.options.jax_settings import package_types


class DemoStart(NamedTuple):
    """The start of a pair of scripted demonstrations.

    `forward` is the start of the forward demonstration. `backward` is the start of the backward one; None starts it at
    the end of the forward one. `backward_goal [g]` is its goal; None records no backward demonstration.
    """

    forward: State
    backward: State | None
    backward_goal: np.ndarray | None


class DemoScript(NamedTuple):
    """How demonstrations of a task are recorded.

    `starts(seed)` yields one item for each forward demonstration. The noise is uniform in [-`noise`, `noise`], on all
    components of an action but the last. A demonstration goes on for `hold` steps, also after success; None ends it at
    success. `action(obs [s + g])` returns the action [a] before noise, of NumPy's arrays; None stands for the expert.
    """

    noise: float
    starts: Callable[[int], Iterator[DemoStart]]
    hold: int | None = None
    action: Callable[[np.ndarray], np.ndarray] | None = None


@dataclasses.dataclass(frozen=True)
class TaskDemos:
    """The demonstrations of a task: those in `file`, or those that ship with `task`."""

    task: str
    file: str | None
    sizes: tuple[int, int, int]
    """The lengths of a state, a goal and an action, which recorded demonstrations must have."""
    layout: Callable[[assets.Demos], assets.Demos] = lambda demos: demos
    """Converts recorded demonstrations to the layout of the task."""
    expert: Callable[[jax.Array], jax.Array] | None = None
    """Returns the action [a] of a scripted controller that reaches the goal in an observation [s + g]."""
    script: DemoScript | None = None
    state_at: Callable[[jax.Array, jax.Array], State] | None = None
    """Returns a state with the state vector [s] and the goal [g], to replay a forward demonstration from: an arm is in its
    reset pose. None if the task can only start from `reset`."""
    exchanged: bool = False
    """Whether the recorded directions are exchanged: the task leads back to where the recorded one starts."""

    def __post_init__(self):
        """Give `expert` and `state_at` the package's types, as `Env.reset` and `Env.step` have them."""
        for name in ("expert", "state_at"):
            function = getattr(self, name)
            object.__setattr__(self, name, function and package_types()(function))

    @property
    def recorded(self) -> bool:
        """Whether there are recorded demonstrations."""
        return self.file is not None or assets.has_demos(self.task)

    @property
    def directions(self) -> tuple[str, ...]:
        """The directions with recorded demonstrations; a ValueError if `file` is missing."""
        recorded = assets.demo_directions(self._source) if self.recorded else ()
        return tuple(direction for direction in assets.DIRECTIONS if self._as_recorded(direction) in recorded)

    def _as_recorded(self, direction: str) -> str:
        """Return the name of `direction` in the recordings."""
        return {"forward": "backward", "backward": "forward"}.get(direction, direction) if self.exchanged else direction

    @property
    def _source(self) -> str:
        return self.task if self.file is None else self.file

    def load(self, direction: str) -> assets.Demos:
        """Return the recorded demonstrations of `direction` (forward or backward) in the task's layout.

        Raises:
            ValueError: this direction has no demonstrations, or the file holds none; the message lists the choices. Or their
                transitions have other sizes than those of the task.
        """
        demos = self.layout(assets.demos(self._source, self._as_recorded(direction)))
        for name, size in zip(("states", "goals", "actions"), self.sizes, strict=True):
            own = getattr(demos, name).shape[1]
            if own != size:
                raise InputError(
                    f"{self._source} is of another task or variant than this {self.task}: its {direction} {name} have {own} "
                    f"numbers, not {size}"
                )
        return demos
