"""Statistics over seeds: against published formulas, by hand, and inside `jit` and `vmap` against NumPy."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from earl_jax.metrics.aggregates import optimality_gap, performance_profile, probability_of_improvement
from earl_jax.metrics.scores import deployed_area, lifetime_scores, regret
from earl_jax.metrics.statistics import bootstrap, iqm, relative_drop, stderr, summarise

RUNS, SEEDS = 3, 9
STEPS = np.array([10, 30, 40])


def test_summary_by_hand():
    """The standard error divides by n, as in the paper's tables, not by n - 1."""
    scores = np.array([0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 1.0, 1.0])
    summary = summarise(scores)
    assert summary.mean == pytest.approx(0.625)
    assert summary.stderr == pytest.approx(np.sqrt(((scores - 0.625) ** 2).mean()) / np.sqrt(8))
    assert summary.iqm == pytest.approx(np.mean([0.4, 0.6, 0.8, 1.0]))
    assert summary.seeds == 8
    assert np.isnan(stderr([0.5])), "one seed says nothing of the spread"
    assert summary.low < summary.iqm < summary.high


@pytest.mark.parametrize("count", [1, 3, 4, 10, 31])
def test_the_interquartile_mean_on_the_host_has_the_bits_of_scipy(count):
    table = np.random.default_rng(count).normal(size=(count, 5))
    np.testing.assert_array_equal(iqm(table), stats.trim_mean(table, 0.25, axis=None))
    np.testing.assert_array_equal(iqm(table, axis=0), stats.trim_mean(table, 0.25, axis=0))


def test_the_bootstrap_interval_covers_the_truth_at_about_its_level():
    rng = np.random.default_rng(0)
    means = [bootstrap(rng.normal(size=20), np.mean) for _ in range(200)]
    assert 0.87 <= np.mean([low <= 0 <= high for low, high in means]) <= 0.98


def test_bootstrap_is_stratified_and_reproducible():
    """Two tasks of constant but different scores: resampling within tasks gives one value."""
    table = np.tile([0.0, 1.0], (10, 1))
    assert bootstrap(table) == bootstrap(table) == (0.5, 0.5)
    noisy = np.random.default_rng(1).normal(size=(10, 2))
    assert bootstrap(noisy) == bootstrap(noisy)


def test_a_single_seed_has_no_interval():
    one, two = np.array([[0.3]]), np.array([[0.1], [0.2]])
    estimates = probability_of_improvement(one, two), optimality_gap(one), summarise(one[0])
    assert [float(estimate[0]) for estimate in estimates] == pytest.approx([1.0, 0.7, 0.3])
    assert all(math.isnan(estimate.low) and math.isnan(estimate.high) for estimate in estimates)
    assert np.isnan(performance_profile(one, np.array([0.1]))).tolist() == [[False], [True], [True]]


@pytest.mark.parametrize("bad", [[], [np.nan, 1.0], [[1.0], [2.0]]])
def test_empty_or_non_finite_scores_are_refused(bad):
    with pytest.raises(ValueError, match="finite scores"):
        summarise(np.array(bad))


def test_drops_by_hand():
    assert relative_drop(np.array([1.0, 0.5]), np.array([0.5, 0.25])) == pytest.approx((0.5, 0.5, 0.5))
    assert relative_drop(np.array([1.0, 0.0]), np.array([0.4, 0.0])) == pytest.approx((0.6, 0.6, 0.6))
    assert math.isnan(relative_drop(np.zeros(2), np.array([0.4, 0.0])).value)
    with pytest.raises(ValueError, match="3 before and 5 after"):
        relative_drop(np.ones(3), np.ones(5))


def test_the_probability_of_improvement_is_the_mann_whitney_statistic_of_each_task():
    rng = np.random.default_rng(0)
    scores, others = rng.integers(0, 5, (6, 3)).astype(float), rng.integers(0, 4, (4, 3)).astype(float)
    shares = [stats.mannwhitneyu(scores[:, task], others[:, task]).statistic / 24 for task in range(3)]
    result = probability_of_improvement(scores, others)
    assert result.value == pytest.approx(np.mean(shares))
    assert result.low < result.value < result.high
    assert probability_of_improvement(scores, scores).value == pytest.approx(0.5)
    assert probability_of_improvement(np.full(3, 0.1 + 0.2), np.full(3, 0.3)).value == 0.5, "rounding is no improvement"
    assert probability_of_improvement(scores + 9, others).low == 1.0
    assert probability_of_improvement(scores[:, 0], others[:, 0]).value == pytest.approx(shares[0])
    with pytest.raises(ValueError, match="scores of the same tasks, but have 3 and 1"):
        probability_of_improvement(scores, others[:, :1])


def test_the_optimality_gap_does_not_reward_scores_above_the_best():
    assert optimality_gap(np.array([[1.5, 0.5], [2.0, 1.0]])).value == pytest.approx(0.125)
    assert optimality_gap(np.array([[5.0], [5.0]]), best=10).value == 5.0


def test_a_performance_profile_is_the_share_of_runs_above_each_threshold():
    profile = performance_profile(np.array([[0.0, 1.0], [0.6, 1.0]]), np.array([-0.1, 0.0, 0.5, 1.0]))
    np.testing.assert_allclose(profile[0], [1.0, 0.75, 0.75, 0.0])
    assert (profile[1] <= profile[0]).all()
    assert (profile[0] <= profile[2]).all()


def every_metric(curves, others):
    """Return all metrics of one run's `curves` and `others` [SEEDS, len(STEPS)] by name."""
    first, other = curves[:, 0], others[:, 0]
    return {
        "regret": regret(STEPS, curves, 1.0),
        "scores": lifetime_scores(STEPS, {"success": curves, "continuing/reward": others}, "success"),
        "iqm": (iqm(curves), iqm(curves, axis=0), iqm(curves, axis=-1)),
        "stderr": stderr(curves),
        "bootstrap": (bootstrap(curves), bootstrap(first)),
        "summary": summarise(deployed_area(STEPS, curves)),
        "drop": relative_drop(first, other),
        "drop from 0": relative_drop(0 * first, other),
        "rare success": relative_drop(first * (np.arange(SEEDS) < 1), other),
        "one seed's drop": relative_drop(first[:1], other[:1]),
    }


def test_metrics_of_a_batch_of_runs_in_one_program_equal_numpys():
    curves, others = np.random.default_rng(0).uniform(size=(2, RUNS, SEEDS, len(STEPS))).astype(np.float32)
    actual = jax.jit(jax.vmap(every_metric))(curves, others)
    results = [every_metric(*run) for run in zip(curves, others, strict=True)]
    assert not any(isinstance(leaf, jax.Array) for leaf in jax.tree.leaves(results))
    expected = jax.tree.map(lambda *leaves: np.stack(leaves), *results)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=2e-6, atol=2e-6), actual, expected)


def test_a_score_that_is_nan_propagates():
    scores = np.array([0.0, np.nan, 1.0, 0.5, 0.5])  # the interquartile mean of five has no place for the last one
    summary = jax.jit(summarise)(jnp.asarray(scores))
    assert np.isnan([summary.mean, summary.iqm, summary.low, iqm(scores)]).all()
    assert np.isnan([*optimality_gap(scores), *performance_profile(scores, np.array([0.4])).ravel()]).all()
