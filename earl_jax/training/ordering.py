"""Order inside a compiled program: a value that is known only after others were computed.

XLA orders operations by data alone. A comparison that is always false adds the missing dependency and changes no value.
"""

from typing import Any

import jax
import jax.numpy as jnp

UNLIKELY = -1.2345e38
"""A number that the arrays of a program never sum up to."""


def after(value: jax.Array, *dependencies: Any) -> jax.Array:
    """Return the integers `value`, unchanged, but available only after every array in the trees `dependencies`."""
    leaves = jax.tree.leaves(dependencies)
    if not leaves:
        return value
    return value + (sum(leaf.ravel()[0].astype(jnp.float32) for leaf in leaves) == UNLIKELY)
