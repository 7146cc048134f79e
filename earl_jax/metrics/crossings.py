"""The training steps at which a learning curve reaches a level, with an interval over seeds."""

import math

import numpy as np

from earl_jax.metrics.comparison import band
from earl_jax.metrics.statistics import Estimate

CROSSING_WINDOW = 100_000
"""Training steps over which evaluations are averaged before a crossing is read: ten evaluations of the paper's runs."""
ROUNDING = 1e-9
"""How far below a level a mean may be to reach it, because sums of equal scores are rounded."""


def trailing_mean(steps: np.ndarray, scores: np.ndarray) -> np.ndarray:
    """Return the mean of `scores [..., E]` over the last `CROSSING_WINDOW` steps before each of `steps [E]`.

    It is nan at steps before the first complete window.
    """
    means = np.full(np.shape(scores), np.nan)
    for last in np.flatnonzero(np.asarray(steps) >= CROSSING_WINDOW):
        first = np.searchsorted(steps, steps[last] - CROSSING_WINDOW, side="right")
        means[..., last] = np.mean(scores[..., first : last + 1], axis=-1)
    return means


def crossing(steps: np.ndarray, scores: np.ndarray, level: float) -> Estimate:
    """Return the first of `steps [E]` at which the seeds' trailing mean of rates `scores [N, E]` reaches `level`.

    The interval runs from the first step at which the upper end of the 95 % interval of the mean reaches the level
    to the first at which the lower end does. Each number is nan if the curve does not reach the level.
    """
    mean, low, high = band(trailing_mean(steps, scores), rate=True)
    return Estimate(*(_first(steps, curve, level) for curve in (mean, high, low)))


def _first(steps: np.ndarray, curve: np.ndarray, level: float) -> float:
    reached = np.flatnonzero(curve >= level - ROUNDING)
    return float(steps[reached[0]]) if len(reached) else math.nan
