"""Measures of the spread of visited positions over a lane's map.

Source: Sharma et al. 2022, figure 4, which shows such maps without a measure; the measures are ours.
"""

import math
from typing import Any

import numpy as np

from earl_jax.metrics.namespace import namespace_of, plain

MEASURES = ("covered", "entropy", "concentration")
TOP_SHARE = 0.01
"""The share of bins, the most visited ones, whose visits `concentration` sums."""


def measure(visits: Any) -> dict[str, Any]:
    """Return `covered`, `entropy` and `concentration` of `visits [B, B]`, all between 0 and 1, and 0 without visits.

    Numbers of a NumPy array; arrays [] of a JAX array, inside `jit` and `vmap` too.
    """
    xp = namespace_of(visits)
    flat = xp.sort(xp.asarray(visits, float).ravel())[::-1]
    total = flat.sum()
    shares = flat / xp.where(total > 0, total, 1.0)
    visited = shares[shares > 0] if xp is np else xp.where(shares > 0, shares, 1.0)  # 1 adds nothing to the entropy
    entropy = 0.0 - (visited * xp.log(visited)).sum() / math.log(max(flat.size, 2))
    values = (shares > 0).mean(), entropy, shares[: math.ceil(TOP_SHARE * flat.size)].sum()
    return {name: plain(value) for name, value in zip(MEASURES, values, strict=True)}
