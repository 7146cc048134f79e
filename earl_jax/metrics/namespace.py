"""The array module of a statistic's arguments, so that one function serves NumPy on the host and JAX inside `jit`."""

from typing import Any

import numpy as np


def namespace_of(*arrays: Any) -> Any:
    """Return the array module of `arrays`: `jax.numpy` if one of them is a JAX array or traced, else `numpy`.

    It is the array API's `__array_namespace__`; lists and Python numbers count as NumPy's.
    """
    modules = [array.__array_namespace__() for array in arrays if hasattr(array, "__array_namespace__")]
    return next((module for module in modules if module is not np), np)


def plain(value: Any) -> Any:
    """Return a NumPy scalar as a Python float, which tables and JSON take; a JAX array as it is."""
    return float(value) if namespace_of(value) is np else value
