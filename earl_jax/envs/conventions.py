"""Names under which other libraries expect the numbers of a task: brax's and Playground's sizes, gymnasium's spaces."""

from typing import TYPE_CHECKING

import numpy as np

from earl_jax.errors import InputError

if TYPE_CHECKING:
    from gymnasium.spaces import Box


class Conventions:
    """Sizes, spaces and durations of a task by the names of brax and gymnasium; an `Env` has them all."""

    if TYPE_CHECKING:  # an Env has them
        obs_size: int
        action_size: int

    @property
    def observation_size(self) -> int:
        """Length of `obs`, state and goal: brax's name of `obs_size`."""
        return self.obs_size

    @property
    def observation_space(self) -> "Box":
        """Gymnasium's space of `obs`, float32 [s + g] without bounds.

        Raises:
            ValueError: gymnasium is not installed.
        """
        return _box(np.inf, self.obs_size)

    @property
    def action_space(self) -> "Box":
        """Gymnasium's space of actions, float32 [a] in [-1, 1]. Errors as `observation_space`."""
        return _box(1.0, self.action_size)


def _box(bound: float, size: int) -> "Box":
    """Return the float32 space [-bound, bound]^size. gymnasium is imported here, because it takes time."""
    try:
        from gymnasium.spaces import Box
    except ImportError as error:
        raise InputError("the spaces of a task are gymnasium's: pip install gymnasium") from error
    return Box(-bound, bound, (size,), np.float32)
