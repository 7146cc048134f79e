"""How much of a success is left where a policy does not start where it was trained to.

Source: Sharma et al. 2022, figure 5.
"""

import math

import numpy as np

from earl_jax.metrics.statistics import RESAMPLES, Estimate, middle


def relative_drop(before: np.ndarray, after: np.ndarray) -> Estimate:
    """Return 1 - mean(`after`) / mean(`before`) of the same seeds, [seeds] each, with its bootstrap interval.

    Seeds are resampled in pairs; resamples without any success before say nothing and are left out. Nothing before: nan.
    """
    before, after = np.asarray(before, float), np.asarray(after, float)
    if not before.mean() > 0:
        return Estimate(math.nan, math.nan, math.nan)
    value = float(1 - after.mean() / before.mean())
    if len(before) < 2:
        return Estimate(value, math.nan, math.nan)
    picks = np.random.default_rng(0).integers(len(before), size=(RESAMPLES, len(before)))
    kept = picks[before[picks].mean(axis=1) > 0]
    return Estimate(value, *middle(1 - after[kept].mean(axis=1) / before[kept].mean(axis=1)))
