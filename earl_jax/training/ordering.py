"""The order of operations in a compiled program: a value that is available only after others.

XLA orders operations by data dependencies alone. A comparison that is always false adds a dependency and changes no
value.
"""

from typing import Any

import jax
import jax.numpy as jnp

UNLIKELY = -1.2345e38
"""A number that sums of a program's arrays never equal."""


def after(value: jax.Array, *dependencies: Any) -> jax.Array:
    """Return the integers `value` unchanged, but available only after every array in the trees `dependencies`."""
    leaves = jax.tree.leaves(dependencies)
    if not leaves:
        return value
    return value + (sum(leaf.ravel()[0].astype(jnp.float32) for leaf in leaves) == UNLIKELY)
