"""Rows of arrays outside programs taken by NumPy: JAX compiles a program for each shape and kind of index.

The tests read thousands of elements, and a program takes 10 ms. NumPy returns the same numbers and is stricter: an index
outside the array is an error, where JAX takes the nearest one.
"""

import jax.numpy as jnp
import numpy as np

try:
    from jax._src.array import ArrayImpl
except ImportError:  # another release keeps it elsewhere, and the tests index as users do
    ArrayImpl = None

STATIC = (int, np.integer, slice, type(None), type(Ellipsis))


def install():
    """Let arrays outside programs take static indices by NumPy."""
    if ArrayImpl is not None and not hasattr(ArrayImpl.__getitem__, "by_jax"):
        ArrayImpl.__getitem__ = _indexing(ArrayImpl.__getitem__)


def _indexing(by_jax):
    def getitem(array, index):
        if not _is_static(index) or not _is_plain(array):
            return by_jax(array, index)
        return jnp.asarray(np.asarray(array)[index].copy())

    getitem.by_jax = by_jax
    return getitem


def _is_static(index):
    parts = index if isinstance(index, tuple) else (index,)
    return all(isinstance(part, STATIC) and not isinstance(part, bool) for part in parts)


def _is_plain(array):
    """Return whether NumPy has the elements of `array`, which are all on the only device of the tests."""
    return isinstance(array.dtype, np.dtype) and not array.weak_type and len(array.sharding.device_set) == 1
