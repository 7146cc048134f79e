"""NumPy arrays and scalars placed on the device without a program: JAX compiles one for each shape that `jnp.asarray` meets."""

import copy

import jax

try:
    from jax._src.core import stage_p
except ImportError:  # another release has no such operation, and gives arrays to the device as for users
    stage_p = None


def install():
    """Let JAX place what `jnp.asarray` gets outside programs on the device directly."""
    if stage_p is not None:
        stage_p.def_impl(_placed)


def _placed(value):
    """Return `value` as an array of its own, which later changes of a NumPy array do not reach."""
    return value if isinstance(value, jax.Array) else jax.device_put(copy.copy(value))
