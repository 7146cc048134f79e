"""Tests of the difference between two groups of seeds, and their correction for many tests.

Source: Welch 1947 and Holm 1979, by scipy.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

SIGNIFICANT = 0.05


class Comparison(NamedTuple):
    """A difference of two means with its 95 % interval and p-value; nan where it cannot be tested."""

    value: float
    low: float
    high: float
    p: float


def welch(scores: np.ndarray, others: np.ndarray) -> Comparison:
    """Return mean(`scores`) - mean(`others`) of independent seeds, [seeds] each, by Welch's t-test.

    It has no interval and no p with fewer than two seeds on a side, or if all seeds of both sides are equal.
    """
    scores, others = np.asarray(scores, float), np.asarray(others, float)
    value = float(scores.mean() - others.mean())
    if min(len(scores), len(others)) < 2 or not (np.ptp(scores) or np.ptp(others)):
        return Comparison(value, math.nan, math.nan, math.nan)
    result: Any = stats.ttest_ind(scores, others, equal_var=False)
    interval = result.confidence_interval(0.95)
    return Comparison(value, float(interval.low), float(interval.high), float(result.pvalue))


def holm(p_values: Sequence[float]) -> list[float]:
    """Return `p_values` corrected by Holm's method; those that are nan stay so and count as no test."""
    corrected = [math.nan] * len(p_values)
    order = sorted((index for index, p in enumerate(p_values) if not math.isnan(p)), key=lambda index: p_values[index])
    largest = 0.0
    for rank, index in enumerate(order):
        largest = max(largest, min(1.0, (len(order) - rank) * p_values[index]))
        corrected[index] = largest
    return corrected
