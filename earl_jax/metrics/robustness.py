"""Robustness: the loss of success from starts that differ from those of training.

Source: Sharma et al. 2022, figure 5.
"""

from typing import Any

import numpy as np

from earl_jax.metrics.namespace import namespace_of, plain
from earl_jax.metrics.statistics import RESAMPLES, Estimate


def relative_drop(before: Any, after: Any) -> Estimate:
    """Return 1 - mean(`after`) / mean(`before`) of the same seeds, [seeds] each, with its bootstrap interval.

    Seeds are resampled in pairs. Resamples whose mean of `before` is 0 are left out. The result is nan if `before` is
    0. The arguments are NumPy or JAX arrays, inside `jit` and `vmap` too.
    """
    xp = namespace_of(before, after)
    before, after = xp.asarray(before, float), xp.asarray(after, float)
    value = _drop(xp, before, after)
    if len(before) < 2:
        return Estimate(plain(value), plain(value * np.nan), plain(value * np.nan))
    picks = np.random.default_rng(0).integers(len(before), size=(RESAMPLES, len(before)))
    drops = xp.where(xp.isnan(value), 0.0, _drop(xp, before[picks], after[picks]))
    low, high = xp.nanquantile(drops, np.array([0.025, 0.975])) + 0.0 * value  # nan if the value is
    return Estimate(plain(value), plain(low), plain(high))


def _drop(xp: Any, before: Any, after: Any) -> Any:
    """Return the relative drops [...] of `before [..., seeds]` and `after`, nan where `before` is 0."""
    mean = before.mean(axis=-1)
    return 1 - after.mean(axis=-1) / xp.where(mean > 0, mean, np.nan)
