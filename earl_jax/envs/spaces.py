"""Gymnasium's spaces."""

from typing import TYPE_CHECKING

import numpy as np

from earl_jax.errors import InputError

if TYPE_CHECKING:
    from gymnasium.spaces import Box


def box(bound: float, size: int) -> "Box":
    """Return the float32 space [-bound, bound]^size.

    Raises:
        ValueError: gymnasium is not installed.
    """
    try:
        from gymnasium.spaces import Box  # takes time to import
    except ImportError as error:
        raise InputError("the spaces of a task are gymnasium's: pip install gymnasium") from error
    return Box(-bound, bound, (size,), np.float32)
