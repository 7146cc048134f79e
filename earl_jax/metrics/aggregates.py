"""Scores of methods over several tasks: probability of improvement, performance profiles, optimality gap.

Source: Agarwal et al. 2021, "Deep Reinforcement Learning at the Edge of the Statistical Precipice", sections 4.2 and 4.3.
Scores are normalised: 1 is the score to reach. Intervals are percentiles of a bootstrap that resamples the seeds of each
task separately.
"""

import numpy as np

from earl_jax.errors import InputError
from earl_jax.metrics.comparison import ROUNDING
from earl_jax.metrics.statistics import Estimate, bootstrap, percentile_interval, resampled


def probability_of_improvement(scores: np.ndarray, others: np.ndarray) -> Estimate:
    """Return the probability that a seed of `scores [N, tasks]` is better than a seed of `others [M, tasks]`.

    It is the mean over tasks of the share of pairs of seeds in which the first seed is better; a tie counts half.

    Raises:
        ValueError: `scores` and `others` have different numbers of tasks.
    """
    scores, others = _by_task(scores), _by_task(others)
    if scores.shape[1] != others.shape[1]:
        raise InputError(f"both sides need scores of the same tasks, but have {scores.shape[1]} and {others.shape[1]}")

    def probability(first: np.ndarray, second: np.ndarray) -> np.ndarray:
        pairs = first[:, :, None] - second[:, None, :]
        ties = np.abs(pairs) <= ROUNDING * np.abs(second[:, None, :])
        return (np.where(ties, 0.0, np.sign(pairs)) + 1).mean(axis=(1, 2, 3)) / 2

    rng = np.random.default_rng(0)
    interval = percentile_interval(probability(resampled(scores, rng), resampled(others, rng)))
    return Estimate(float(probability(scores[None], others[None])[0]), *interval)


def optimality_gap(scores: np.ndarray, best: float = 1.0) -> Estimate:
    """Return the mean amount by which `scores [N, tasks]` fall short of `best`; scores above it count as `best`."""
    missing = best - np.minimum(_by_task(scores), best)
    return Estimate(float(missing.mean()), *bootstrap(missing, np.mean))


def performance_profile(scores: np.ndarray, thresholds: np.ndarray) -> np.ndarray:
    """Return [3, K]: the share of runs above each of `thresholds [K]`, averaged over tasks, and its interval's ends.

    `scores` have the shape [N, tasks]; the result is nan if a score is nan.
    """
    scores = _by_task(scores)[:, :, None]
    above = np.where(np.isnan(scores), np.nan, scores > np.asarray(thresholds))
    shares = resampled(above, np.random.default_rng(0)).mean(axis=(1, 2))
    return np.stack([above.mean(axis=(0, 1)), *np.quantile(shares, [0.025, 0.975], axis=0)])


def _by_task(scores: np.ndarray) -> np.ndarray:
    """Return `scores` as [N, tasks]; scores of a single task can be [N]."""
    return np.reshape(np.asarray(scores, float), (len(scores), -1))
