"""Statistics against published formulas and by hand."""

import numpy as np
import pytest

from earl_jax.metrics import statistics


def test_summary_by_hand():
    scores = np.array([0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 1.0, 1.0])
    summary = statistics.summarise(scores)
    assert summary.mean == pytest.approx(0.625)
    assert summary.stderr == pytest.approx(np.sqrt(((scores - 0.625) ** 2).mean()) / np.sqrt(8))
    assert summary.iqm == pytest.approx(np.mean([0.4, 0.6, 0.8, 1.0]))
    assert summary.seeds == 8
    assert summary.low < summary.iqm < summary.high


def test_published_standard_errors_are_population_deviations():
    """Five seeds of which one failed: table cells like the paper's 0.80 (0.11) divide by n, not n - 1."""
    assert statistics.stderr(np.array([0.0, 1, 1, 1, 1])) == pytest.approx(0.4 / np.sqrt(5))


def test_the_bootstrap_interval_covers_the_truth_at_about_its_level():
    rng = np.random.default_rng(0)
    intervals = [statistics.bootstrap(rng.normal(size=20), np.mean, seed=i) for i in range(200)]
    covered = np.mean([low <= 0 <= high for low, high in intervals])
    assert 0.87 <= covered <= 0.98


def test_bootstrap_is_stratified_and_reproducible():
    """Two tasks of constant but different scores: resampling within tasks gives one value."""
    table = np.tile([0.0, 1.0], (10, 1))
    assert statistics.bootstrap(table) == statistics.bootstrap(table) == (0.5, 0.5)
    noisy = np.random.default_rng(1).normal(size=(10, 2))
    assert statistics.bootstrap(noisy, seed=3) == statistics.bootstrap(noisy, seed=3)


@pytest.mark.parametrize("bad", [[], [np.nan, 1.0], [[1.0], [2.0]]])
def test_empty_or_non_finite_scores_are_refused(bad):
    with pytest.raises(ValueError, match="finite scores"):
        statistics.summarise(np.array(bad))


def test_the_interval_of_a_difference_covers_its_resamples():
    assert statistics.difference(np.array([5.0, 6.0]), np.array([1.0, 2.0])) == (4, 3, 5)
    no_difference = statistics.difference(np.ones(3), np.arange(3))
    assert no_difference.low < 0 < no_difference.high
    single_seed = statistics.difference(np.ones(1), np.zeros(5))
    assert single_seed.value == 1
    assert np.isnan([single_seed.low, single_seed.high]).all()
