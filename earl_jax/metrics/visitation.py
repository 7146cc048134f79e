"""Measures of a map of visited positions: spread, distance to given places, and shares near places and in corners.

Source: Sharma et al. 2022, figure 3, whose text says that resets keep an agent near the initial and goal distributions
and that without resets it moves further away, into the corners. The paper prints no measure; these are ours. All
functions accept NumPy or JAX arrays and can be traced by `jit`.
"""

import math
from typing import Any

import numpy as np

from earl_jax.metrics.statistics import as_float, namespace_of

MEASURES = ("covered", "entropy", "concentration")
TOP_SHARE = 0.01
"""`concentration` is the share of visits in this share of bins, the most visited ones."""
CORNER = 0.1
"""Side of a corner of the map, as a share of the map's side."""


def measure(visits: Any) -> dict[str, Any]:
    """Return `covered`, `entropy` and `concentration` of `visits [B, B]`, all between 0 and 1, and 0 without visits.

    The values are numbers for a NumPy array, and arrays [] for a JAX array, also inside `jit` and `vmap`.
    """
    xp = namespace_of(visits)
    flat = xp.sort(xp.asarray(visits, float).ravel())[::-1]
    total = flat.sum()
    shares = flat / xp.where(total > 0, total, 1.0)
    visited = shares[shares > 0] if xp is np else xp.where(shares > 0, shares, 1.0)  # 1 adds nothing to the entropy
    entropy = 0.0 - (visited * xp.log(visited)).sum() / math.log(max(flat.size, 2))
    values = (shares > 0).mean(), entropy, shares[: math.ceil(TOP_SHARE * flat.size)].sum()
    return {name: as_float(value) for name, value in zip(MEASURES, values, strict=True)}


def bin_centres(map_bounds: np.ndarray, bins: int) -> np.ndarray:
    """Return the centres [B, B, 2] of `bins` by `bins` bins over `map_bounds`, [[x, y] low, [x, y] high]."""
    low, high = np.asarray(map_bounds, float)
    shares = (np.arange(bins) + 0.5) / bins
    return low + np.stack(np.meshgrid(shares, shares, indexing="ij"), axis=-1) * (high - low)


def mean_distance(visits: Any, map_bounds: np.ndarray, places: np.ndarray) -> Any:
    """Return the distance from a bin's centre to the nearest of `places` [K, 2], averaged over `visits` [..., B, B].

    The result [...] is in the unit of the map, and 0 without visits.
    """
    return _mean(visits, _to_nearest(map_bounds, visits.shape[-1], places))


def share_near(visits: Any, map_bounds: np.ndarray, places: np.ndarray, radius: float) -> Any:
    """Return the share [...] of `visits` [..., B, B] in bins whose centre is within `radius` of any `places` [K, 2]."""
    near = _to_nearest(map_bounds, visits.shape[-1], places) <= radius
    return _mean(visits, near.astype(float))


def share_in_corners(visits: Any) -> Any:
    """Return the share [...] of `visits` [..., B, B] in the four corners, squares with a tenth of the map's side."""
    centres = bin_centres(np.array([[0.0, 0.0], [1.0, 1.0]]), visits.shape[-1])
    corners = np.all(np.minimum(centres, 1 - centres) < CORNER, axis=-1)
    return _mean(visits, corners.astype(float))


def _to_nearest(map_bounds: np.ndarray, bins: int, places: np.ndarray) -> np.ndarray:
    """Return the distance [B, B] of each bin's centre to the nearest of `places` [K, 2]."""
    offsets = bin_centres(map_bounds, bins)[:, :, None] - np.asarray(places, float)
    return np.linalg.norm(offsets, axis=-1).min(axis=-1)


def _mean(visits: Any, values: np.ndarray) -> Any:
    """Return the mean [...] of `values` [B, B] over `visits` [..., B, B]."""
    total = visits.sum(axis=(-2, -1))
    return (visits * values).sum(axis=(-2, -1)) / (total + (total == 0))
