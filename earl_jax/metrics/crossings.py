"""The training steps at which a learning curve reaches a level, with an interval over seeds."""

import math

import numpy as np

from earl_jax.metrics.comparison import band
from earl_jax.metrics.statistics import Estimate

CROSSING_WINDOW = 100_000
"""Training steps over which evaluations are averaged before a crossing is read: ten evaluations of the paper's runs."""


def trailing_mean(steps: np.ndarray, scores: np.ndarray) -> np.ndarray:
    """Return the mean of `scores [..., E]` over the last `CROSSING_WINDOW` steps before each of `steps [E]`.

    It is nan where training has not lasted for so many steps yet.
    """
    ends = np.arange(1, len(steps) + 1)
    starts = np.searchsorted(steps, np.asarray(steps) - CROSSING_WINDOW, side="right")
    sums = np.concatenate([np.zeros((*np.shape(scores)[:-1], 1)), np.cumsum(scores, axis=-1, dtype=float)], axis=-1)
    means = (sums[..., ends] - sums[..., starts]) / (ends - starts)
    return np.where(np.asarray(steps) >= CROSSING_WINDOW, means, np.nan)


def crossing(steps: np.ndarray, scores: np.ndarray, level: float) -> Estimate:
    """Return the first of `steps [E]` at which the mean over seeds of the trailing mean of `scores [N, E]` reaches `level`.

    The interval runs from the first step at which the upper end of the 95 % interval of the mean reaches the level
    to the first at which the lower end does. Each number is nan if the curve does not reach the level.
    """
    mean, low, high = band(trailing_mean(steps, scores), rate=True)
    return Estimate(*(_first(steps, curve, level) for curve in (mean, high, low)))


def _first(steps: np.ndarray, curve: np.ndarray, level: float) -> float:
    reached = np.flatnonzero(curve >= level)
    return float(steps[reached[0]]) if len(reached) else math.nan
