"""Tests of metrics/aggregates.py."""

import numpy as np
import pytest
from scipy import stats

from earl_jax.metrics.aggregates import optimality_gap, performance_profile, probability_of_improvement


def test_the_probability_of_improvement_is_the_mann_whitney_statistic_of_each_task():
    rng = np.random.default_rng(0)
    scores, others = rng.integers(0, 5, (6, 3)).astype(float), rng.integers(0, 4, (4, 3)).astype(float)
    shares = [stats.mannwhitneyu(scores[:, task], others[:, task]).statistic / 24 for task in range(3)]
    result = probability_of_improvement(scores, others)
    assert result.value == pytest.approx(np.mean(shares))
    assert result.low < result.value < result.high
    assert probability_of_improvement(scores, scores).value == pytest.approx(0.5)
    assert probability_of_improvement(scores + 9, others).low == 1.0


def test_the_interval_of_the_probability_of_improvement_covers_it():
    rng = np.random.default_rng(0)
    true = stats.norm.cdf(0.5 / np.sqrt(2))
    results = [probability_of_improvement(rng.normal(0.5, 1, (10, 6)), rng.normal(0, 1, (10, 6))) for _ in range(40)]
    assert np.mean([result.low <= true <= result.high for result in results]) >= 0.85


def test_the_optimality_gap_does_not_reward_scores_above_the_best():
    assert optimality_gap(np.array([[1.5, 0.5], [2.0, 1.0]])).value == pytest.approx(0.125)
    assert optimality_gap(np.array([[5.0], [5.0]]), best=10).value == 5.0


def test_a_performance_profile_is_the_share_of_runs_above_each_threshold():
    profile = performance_profile(np.array([[0.0, 1.0], [0.6, 1.0]]), np.array([-0.1, 0.0, 0.5, 1.0]))
    np.testing.assert_allclose(profile[0], [1.0, 0.75, 0.75, 0.0])
    assert (profile[1] <= profile[0]).all()
    assert (profile[0] <= profile[2]).all()
