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

    `starts(seed)` yields one `DemoStart` for each forward demonstration. Uniform noise in [-`noise`, `noise`] is added
    to every component of an action except the last. A demonstration lasts `hold` steps, even after success; None ends
    it at success. `action(obs [s + g])` returns the action [a] before noise, both NumPy arrays; None uses the expert.
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
    """`expert(obs [s + g])` returns the action [a] of a scripted controller that reaches the goal in `obs`."""
    script: DemoScript | None = None
    state_at: Callable[[jax.Array, jax.Array], State] | None = None
    """`state_at(vector [s], goal [g])` returns the state from which a forward demonstration is replayed, with any arm
    in its reset pose. None if the task can only start from `reset`."""
    exchanged: bool = False
    """Whether the recorded directions swap roles, because this task leads back to the start of the recorded task."""

    def __post_init__(self):
        """Run `expert` and `state_at` under the package's jax types, as `Env.reset` and `Env.step` are."""
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
            ValueError: this direction has no demonstrations, or the file contains none (the message lists the choices),
                or the sizes of their transitions differ from those of the task.
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
