"""The metrics inside `jit` and `vmap`, against the same functions on NumPy arrays."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from earl_jax.metrics.robustness import relative_drop
from earl_jax.metrics.scores import deployed_area, lifetime_scores, regret
from earl_jax.metrics.statistics import bootstrap, difference, iqm, mean_of, stderr, summarise
from earl_jax.metrics.visitation import measure

RUNS, SEEDS = 3, 9
STEPS = np.array([10, 30, 40])
METRICS = {
    "regret": lambda curves, others: regret(STEPS, curves, 1.0),
    "scores": lambda curves, others: lifetime_scores(
        STEPS, {"success": curves, "continuing/reward": others}, "success"
    ),
    "iqm": lambda curves, others: (iqm(curves), iqm(curves, axis=0), iqm(curves, axis=-1)),
    "stderr": lambda curves, others: stderr(curves),
    "bootstrap": lambda curves, others: (bootstrap(curves), bootstrap(curves[:, 0], level=0.8, seed=3)),
    "summary": lambda curves, others: summarise(deployed_area(STEPS, curves)),
    "mean": lambda curves, others: (mean_of(curves[:, -1]), mean_of(curves[:1, -1])),
    "difference": lambda curves, others: (difference(curves[:, 0], others[:, 0]), difference(curves[:1], others)),
    "drop": lambda curves, others: relative_drop(curves[:, 0], others[:, 0]),
    "drop from 0": lambda curves, others: relative_drop(0 * curves[:, 0], others[:, 0]),
    "rare success": lambda curves, others: relative_drop(curves[:, 0] * (np.arange(SEEDS) < 1), others[:, 0]),
    "one seed's drop": lambda curves, others: relative_drop(curves[:1, 0], others[:1, 0]),
}


def numpy_of(metric, *runs):
    """Return the metric of each run, by NumPy, stacked."""
    results = [metric(*run) for run in zip(*runs, strict=True)]
    assert not any(isinstance(leaf, jax.Array) for leaf in jax.tree.leaves(results))
    return jax.tree.map(lambda *leaves: np.stack(leaves), *results)


@pytest.mark.parametrize("metric", METRICS.values(), ids=METRICS)
def test_a_metric_of_a_batch_of_runs_in_one_program_equals_numpy(metric):
    curves, others = np.random.default_rng(0).uniform(size=(2, RUNS, SEEDS, len(STEPS))).astype(np.float32)
    actual = jax.jit(jax.vmap(metric))(jnp.asarray(curves), jnp.asarray(others))
    expected = numpy_of(metric, curves, others)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=2e-6, atol=2e-6), actual, expected)


def test_measures_of_maps_in_one_program_equal_numpy():
    visits = np.random.default_rng(0).poisson(0.7, (RUNS, 16, 16))
    visits[1], visits[2, 1:] = 0, 0
    actual = jax.jit(jax.vmap(measure))(jnp.asarray(visits))
    assert actual["covered"].tolist()[1] == 0
    for name, values in numpy_of(measure, visits).items():
        np.testing.assert_allclose(actual[name], values, rtol=1e-6, err_msg=name)


@pytest.mark.parametrize("count", [1, 3, 4, 10, 31])
def test_the_interquartile_mean_on_the_host_has_the_bits_of_scipy(count):
    table = np.random.default_rng(count).normal(size=(count, 5))
    np.testing.assert_array_equal(iqm(table), stats.trim_mean(table, 0.25, axis=None))
    np.testing.assert_array_equal(iqm(table, axis=0), stats.trim_mean(table, 0.25, axis=0))


def test_a_score_that_is_not_finite_is_refused_on_the_host_and_propagates_on_the_device():
    with pytest.raises(ValueError, match="finite scores"):
        summarise(np.array([0.0, np.nan]))
    summary = jax.jit(summarise)(jnp.array([0.0, np.nan, 1.0]))
    assert np.isnan([summary.mean, summary.iqm, summary.low]).all()
