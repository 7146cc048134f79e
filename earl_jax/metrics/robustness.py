"""Robustness: the loss of success from starts that differ from those of training.

Source: Sharma et al. 2022, figure 5.
"""

import math

import numpy as np

from earl_jax.metrics.statistics import RESAMPLES, Estimate, percentile_interval


def relative_drop(before: np.ndarray, after: np.ndarray) -> Estimate:
    """Return 1 - mean(`after`) / mean(`before`) of the same seeds, [seeds] each, with its bootstrap interval.

    Seeds are resampled in pairs. Resamples whose mean of `before` is 0 are left out. The result is nan if `before` is
    0.
    """
    before, after = np.asarray(before, float), np.asarray(after, float)
    if not before.mean() > 0:
        return Estimate(math.nan, math.nan, math.nan)
    value = float(1 - after.mean() / before.mean())
    if len(before) < 2:
        return Estimate(value, math.nan, math.nan)
    picks = np.random.default_rng(0).integers(len(before), size=(RESAMPLES, len(before)))
    valid = picks[before[picks].mean(axis=1) > 0]
    return Estimate(value, *percentile_interval(1 - after[valid].mean(axis=1) / before[valid].mean(axis=1)))
