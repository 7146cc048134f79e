"""Two-sample comparisons of scores over seeds: Welch's test, the permutation test, Holm's correction, detectable differences.

Sources: Welch 1947, "The generalization of Student's problem when several different population variances are involved";
Janssen 1997, "Studentized permutation tests for non-i.i.d. hypotheses and the generalized Behrens-Fisher problem";
Holm 1979, "A simple sequentially rejective multiple test procedure".
"""

import functools
import itertools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy import optimize, stats

from earl_jax.metrics.statistics import Estimate

LEVEL = 0.05
POWER = 0.8
CANNOT_TELL = "cannot tell"
"""The verdict if p is not below `LEVEL`."""
SAME = 1e-12
"""Squared standard error, as a share of the squared mean, up to which the seeds' scores count as equal."""
ROUNDING = 1e-6
"""Relative error up to which two differences of scores count as equal: float32 means can give 0.90000004 for 0.9."""
FEWEST_SEEDS = 3
"""Fewer seeds have no interval: Student's interval of two seeds is wider than any score."""
SPLITS = 20_000
"""Largest number of splits of the seeds that the permutation test enumerates; if there are more, it draws this many."""


class Sample(NamedTuple):
    """The scores of `seeds` seeds as their `mean` and its standard error `stderr`, with n - 1 degrees of freedom."""

    mean: float
    stderr: float
    seeds: int

    @classmethod
    def of(cls, scores: np.ndarray) -> "Sample":
        """Return the sample of `scores [seeds]`; the standard error of a single seed is nan."""
        scores = np.asarray(scores, float)
        error = scores.std(ddof=1) / math.sqrt(len(scores)) if len(scores) > 1 else math.nan
        return cls(float(scores.mean()), float(error), len(scores))


class Comparison(NamedTuple):
    """The difference of two means with its 95 % interval and two-sided p, which are nan if a sample has one seed."""

    difference: float
    low: float
    high: float
    p: float

    @property
    def verdict(self) -> str:
        """`above` or `below` if p is below 5 %, else `CANNOT_TELL`."""
        return verdict(self.difference, self.p)


def verdict(difference: float, p: float) -> str:
    """Return `above` or `below`, by the sign of `difference`, if `p` is below `LEVEL`, else `CANNOT_TELL`."""
    if not p < LEVEL:
        return CANNOT_TELL
    return "above" if difference > 0 else "below"


def mean_interval(scores: np.ndarray, rate: bool = False) -> Estimate:
    """Return the mean of `scores [seeds, ...]` with its `error_interval`, whose ends are nan for fewer than three seeds."""
    scores = np.asarray(scores, float)
    mean, seeds = scores.mean(axis=0), len(scores)
    if seeds < FEWEST_SEEDS:
        low = high = np.full_like(mean, math.nan)
    else:
        low, high = error_interval(mean, scores.std(axis=0, ddof=1) / math.sqrt(seeds), seeds, rate)
    return Estimate(*(end if mean.ndim else float(end) for end in (mean, low, high)))


def error_interval(mean: Any, error: Any, seeds: int, rate: bool) -> tuple[Any, Any]:
    """Return Student's 95 % interval of a `mean [...]` with its standard error over seeds, or the `rate_interval` of a `rate`."""
    if rate:
        return rate_interval(mean, error, seeds)
    half = _quantile(seeds) * error
    return mean - half, mean + half


def rate_interval(mean: Any, error: Any, seeds: int) -> tuple[Any, Any]:
    """Return Wilson's 95 % interval, within [0, 1], of a rate with the `mean [...]` and the standard error `error` over seeds.

    The number of trials is the effective one, mean (1 - mean) / error^2, at least one per seed, and the quantile is
    Student's. If all seeds agree, each seed is one trial: five seeds that all succeed give [0.57, 1].
    tests/metrics/test_comparison.py checks the coverage by simulation.

    Source: Kott and Carr 1997, "Developing an estimation strategy for a pesticide data program", after Wilson 1927.
    """
    mean, variance = np.asarray(mean, float), np.square(error)
    differ = ~is_rounding(variance, mean)  # an unknown error gives nan
    trials = np.where(differ, mean * (1 - mean) / np.where(differ, variance, 1.0), seeds).clip(seeds)
    ratio = np.where(differ, _quantile(seeds), stats.norm.ppf(1 - LEVEL / 2)) ** 2 / trials
    half = np.sqrt(ratio * mean * (1 - mean) + ratio**2 / 4)
    return (mean + ratio / 2 - half) / (1 + ratio), (mean + ratio / 2 + half) / (1 + ratio)


def band(curves: np.ndarray, rate: bool = False) -> Estimate:
    """Return the mean of `curves [seeds, E]` with its 95 % interval at each evaluation, of width 0 if seeds agree."""
    with np.errstate(invalid="ignore"):  # infinite values, such as the loss of a seed that diverged, have none
        mean, low, high = mean_interval(curves, rate)
        same = is_rounding(np.var(curves, axis=0) / (len(curves) - 1), mean) & (len(curves) >= FEWEST_SEEDS)
    return Estimate(mean, np.where(same, mean, low), np.where(same, mean, high))


def is_rounding(variance: Any, mean: Any) -> Any:
    """Return whether scores with this squared standard error of their `mean` count as equal, bool [...]."""
    return variance <= SAME * mean**2


@functools.cache
def _quantile(seeds: int) -> float:
    return float(stats.t.ppf(1 - LEVEL / 2, seeds - 1))


def welch(sample: Sample, other: Sample) -> Comparison:
    """Return `sample` minus `other` by Welch's test of means with unequal variances.

    p and the interval are nan if a sample has one seed or neither sample has a spread. The interval is also nan if a
    sample has fewer than three seeds.
    """
    difference, freedom = sample.mean - other.mean, _freedom(sample, other)
    error = math.hypot(sample.stderr, other.stderr)
    if not error > 0:
        return Comparison(difference, math.nan, math.nan, math.nan)
    half = error * stats.t.ppf(1 - LEVEL / 2, freedom) if _enough(sample, other) else math.nan
    p = 2 * stats.t.sf(abs(difference) / error, freedom)
    return Comparison(difference, float(difference - half), float(difference + half), float(p))


def permutation(scores: np.ndarray, others: np.ndarray) -> Comparison:
    """Return mean(`scores`) minus mean(`others`) of independent seeds, [seeds] each, with p of the permutation test.

    All splits of the seeds are enumerated, or 20,000 are drawn if there are more. Splits are compared by Welch's t
    (Janssen 1997); compared by the difference alone, a side with fewer seeds and a larger spread would differ
    significantly too often. The interval is Welch's. p is nan if a score is not finite.
    """
    result = welch(Sample.of(scores), Sample.of(others))
    if min(len(scores), len(others)) < 2 or not math.isfinite(result.difference):
        return result
    pooled = np.concatenate([np.asarray(scores, float), np.asarray(others, float)])
    weights, drawn = _splits(len(scores), len(others))
    own = np.repeat([1 / len(scores), -1 / len(others)], [len(scores), len(others)])
    if len(scores) == len(others):
        extreme = _larger_differences(weights, own, pooled)
    else:
        extreme = _squared_t(weights, pooled) >= (1 - ROUNDING) * _squared_t(own[None], pooled)
    return result._replace(p=float((extreme.sum() + drawn) / (len(weights) + drawn)))


def _larger_differences(weights: np.ndarray, own: np.ndarray, pooled: np.ndarray) -> np.ndarray:
    """Return whether the difference of each split is at least that of `own`, bool [k]; with equal sides, so is its t.

    Differences count as equal up to `ROUNDING` of the seeds that change sides.
    """
    changed = weights * np.sign(weights @ pooled)[:, None] - own * np.sign(own @ pooled)
    return changed @ pooled >= -ROUNDING * (np.abs(changed) @ np.abs(pooled))


def _squared_t(weights: np.ndarray, pooled: np.ndarray) -> np.ndarray:
    """Return the square of Welch's t of each split [k], infinite for sides without a spread, 0 for sides of the same mean."""
    rounding, centred = ROUNDING * np.abs(pooled).max(), pooled - pooled.mean()
    error = np.zeros(len(weights))
    for side in (weights > 0, weights < 0):
        seeds = side.sum(axis=1)
        variance = (side @ centred**2 - (side @ centred) ** 2 / seeds) / (seeds - 1)
        error += np.where(variance > rounding**2, variance, 0.0) / seeds
    difference = np.abs(weights @ centred)
    with np.errstate(divide="ignore"):
        return np.divide(difference**2, error, out=np.zeros_like(error), where=difference > rounding)


def smallest_p(seeds: int, others: int) -> float:
    """Return the smallest p that `permutation` can give with these seeds, when one side is above all of the other."""
    splits = math.comb(seeds + others, seeds)
    return 1 / (SPLITS + 1) if splits > SPLITS else (2 if seeds == others else 1) / splits


def detectable_difference(sample: Sample, other: Sample) -> float:
    """Return the difference of means that Welch's test with these standard errors detects with a probability of 80 %.

    It is 0 if neither sample has a spread; otherwise it is nan if one of them has fewer than three seeds.
    """
    error, freedom = math.hypot(sample.stderr, other.stderr), _freedom(sample, other)
    if math.isnan(error) or error == 0:
        return error
    if not _enough(sample, other):
        return math.nan
    critical = stats.t.ppf(1 - LEVEL / 2, freedom)

    def missing_power(noncentrality: float) -> float:
        return float(stats.nct.sf(critical, freedom, noncentrality)) - POWER

    return error * optimize.root_scalar(missing_power, bracket=(0.0, 100.0)).root


def holm(values: Sequence[float], tests: int = 0) -> np.ndarray:
    """Return Holm's adjusted p [k] for the p `values [k]` of one family; values that are nan do not count and stay nan.

    If `tests` exceeds the number of values, the family has further tests, whose p values are larger.
    """
    p = np.asarray(values, float)
    order = np.argsort(p)[: np.count_nonzero(~np.isnan(p))]  # nan sorts last
    adjusted = np.full(len(p), math.nan)
    factors = max(tests, len(order)) - np.arange(len(order))
    adjusted[order] = np.minimum(1.0, np.maximum.accumulate(p[order] * factors))
    return adjusted


def _enough(sample: Sample, other: Sample) -> bool:
    return min(sample.seeds, other.seeds) >= FEWEST_SEEDS


def _freedom(sample: Sample, other: Sample) -> float:
    """Return the degrees of freedom of the difference by Welch and Satterthwaite."""
    squares = np.array([sample.stderr, other.stderr]) ** 2
    parts = (squares**2 / np.maximum([sample.seeds - 1, other.seeds - 1], 1)).sum()
    return float(squares.sum() ** 2 / parts) if parts > 0 else math.nan


@functools.cache
def _splits(seeds: int, others: int) -> tuple[np.ndarray, int]:
    """Return the weights [k, seeds + others] of scores in each split's difference, and 1 if they are drawn, else 0."""
    total, drawn = seeds + others, math.comb(seeds + others, seeds) > SPLITS
    if drawn:
        picks = np.argsort(np.random.default_rng(0).random((SPLITS, total)), axis=1)[:, :seeds]
    else:
        picks = np.array(list(itertools.combinations(range(total), seeds)))
    weights = np.full((len(picks), total), -1 / others)
    np.put_along_axis(weights, picks, 1 / seeds, axis=1)
    return weights, int(drawn)
