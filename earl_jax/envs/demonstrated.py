"""The part of a task that its demonstrations need: those that ship or are imported, an expert, and a script."""

import functools
from collections.abc import Iterator
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax import assets
from earl_jax.envs.state import DemoStart
from earl_jax.errors import InputError


class Demonstrated:
    """The demonstrations of an `Env`."""

    name: ClassVar[str]
    demo_file: str | None
    demo_noise: ClassVar[float | None] = None
    """Half-width of the uniform noise that a demonstration script adds to all actions but the last; None without a
    script."""
    demo_hold: ClassVar[int | None] = None
    """Length in steps of a scripted demonstration that continues after success; None if it ends at success."""

    @property
    def has_demos(self) -> bool:
        """Whether there are demonstrations of this task."""
        return self.demo_file is not None or assets.has_demos(self.name)

    @property
    def demo_directions(self) -> tuple[str, ...]:
        """The directions with demonstrations."""
        return assets.demo_directions(self.demo_file or self.name)

    def demos(self, direction: str) -> assets.Demos:
        """Return the demonstrations of `direction` (forward or backward) in this task's layout.

        Raises:
            ValueError: this direction has no demonstrations, or the file holds none; the message lists the choices.
        """
        return assets.demos(self.demo_file or self.name, direction)

    def expert(self, obs: jax.Array) -> jax.Array:
        """Return the action [a] of a scripted controller that reaches the goal in `obs [s + g]`.

        Raises:
            ValueError: this task has no scripted controller.
        """
        raise InputError(f"{self.name} has no scripted expert")

    def demo_action(self, obs: np.ndarray) -> np.ndarray:
        """Return the action [a] of the demonstration script at `obs [s + g]`, before noise: the expert's by default."""
        return np.array(_expert_action(self, jnp.asarray(obs)))

    def demo_starts(self, seed: int) -> Iterator[DemoStart]:
        """Yield the starts of scripted demonstrations, one item for each forward demonstration.

        Raises:
            ValueError: this task has no demonstration script.
        """
        del seed
        raise InputError(f"{self.name} has no demonstration script")


@functools.partial(jax.jit, static_argnums=0)
def _expert_action(env: Demonstrated, obs: jax.Array) -> jax.Array:
    return env.expert(obs)
