"""Statistics over seeds: mean, standard error, interquartile mean and stratified-bootstrap intervals.

Source: Agarwal et al. 2021, "Deep Reinforcement Learning at the Edge of the Statistical Precipice", section 4.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from earl_jax.errors import InputError

RESAMPLES = 2000


class Estimate(NamedTuple):
    """A number with its 95 % interval, whose ends are nan if there are too few seeds."""

    value: float
    low: float
    high: float


class Summary(NamedTuple):
    """A summary of scores: `mean`, `stderr`, `iqm` with its 95 % interval `low` to `high`, number of `seeds`."""

    mean: float
    stderr: float
    iqm: float
    low: float
    high: float
    seeds: int


def stderr(scores: np.ndarray) -> np.ndarray:
    """Return the standard error over the first axis: population standard deviation / sqrt(n), as in the paper."""
    return np.std(scores, axis=0) / np.sqrt(np.shape(scores)[0])


def iqm(scores: np.ndarray, axis: Any = None) -> np.ndarray:
    """Return the interquartile mean of `scores`: the mean without the lowest and the highest quarter."""
    return stats.trim_mean(scores, 0.25, axis=axis)


def bootstrap(scores: np.ndarray, statistic=iqm, level: float = 0.95, seed: int = 0) -> tuple[float, float]:
    """Return the percentile interval of `statistic` over `scores [seeds, tasks]`, resampling seeds within each task.

    The scores of a single task can have the shape [seeds]. The same `seed` returns the same interval.
    """
    table = np.asarray(scores, float).reshape(len(scores), -1)
    rng = np.random.default_rng(seed)
    picks = rng.integers(len(table), size=(RESAMPLES, *table.shape))
    resampled = table[picks, np.arange(table.shape[1])].reshape(RESAMPLES, -1)
    low, high = np.quantile(statistic(resampled, axis=1), [(1 - level) / 2, (1 + level) / 2])
    return float(low), float(high)


def summarise(scores: np.ndarray) -> Summary:
    """Return the `Summary` of `scores [seeds]`.

    Raises:
        ValueError: there are no scores, or one is not finite.
    """
    scores = np.asarray(scores, float)
    if scores.ndim != 1 or not len(scores) or not np.isfinite(scores).all():
        raise InputError(f"expected finite scores of at least one seed, got {scores}")
    low, high = bootstrap(scores)
    return Summary(float(scores.mean()), float(stderr(scores)), float(iqm(scores)), low, high, len(scores))


def mean_of(scores: np.ndarray) -> Estimate:
    """Return the mean of `scores [seeds]` with its bootstrap interval."""
    value = float(np.mean(scores))
    return Estimate(value, *bootstrap(scores, np.mean)) if len(scores) > 1 else Estimate(value, math.nan, math.nan)


def difference(scores: np.ndarray, others: np.ndarray) -> Estimate:
    """Return mean(`scores`) - mean(`others`) of independent seeds, [seeds] each, with its bootstrap interval."""
    value = float(np.mean(scores) - np.mean(others))
    if min(len(scores), len(others)) < 2:
        return Estimate(value, math.nan, math.nan)
    rng = np.random.default_rng(0)
    means = [
        np.asarray(group)[rng.integers(len(group), size=(RESAMPLES, len(group)))].mean(axis=1)
        for group in (scores, others)
    ]
    return Estimate(value, *percentile_interval(means[0] - means[1]))


def percentile_interval(resampled: np.ndarray) -> tuple[float, float]:
    """Return the percentile interval of 95 % of `resampled [R]`."""
    low, high = np.quantile(resampled, [0.025, 0.975])
    return float(low), float(high)
