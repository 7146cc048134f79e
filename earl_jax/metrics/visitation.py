"""Measures of the spread of visited positions over a lane's map.

Source: Sharma et al. 2022, figure 4, which shows such maps without a measure; the measures are ours.
"""

import math

import numpy as np

MEASURES = ("covered", "entropy", "concentration")
TOP_SHARE = 0.01
"""The share of bins, the most visited ones, whose visits `concentration` sums."""


def measure(visits: np.ndarray) -> dict[str, float]:
    """Return `covered`, `entropy` and `concentration` of `visits [B, B]`, all between 0 and 1, and 0 without visits."""
    flat = np.sort(np.ravel(visits).astype(float))[::-1]
    if not flat.sum():
        return dict.fromkeys(MEASURES, 0.0)
    shares = flat / flat.sum()
    visited = shares[shares > 0]
    entropy = -(visited * np.log(visited)).sum() / math.log(flat.size) if flat.size > 1 else 0.0
    concentration = shares[: math.ceil(TOP_SHARE * flat.size)].sum()
    return dict(zip(MEASURES, (len(visited) / flat.size, float(entropy), float(concentration)), strict=True))
