"""Tests of metrics/comparison.py. Rates of false alarms and coverage are simulated: five per cent has to mean five."""

import math

import numpy as np
import pytest
from scipy import stats

from earl_jax.metrics.comparison import (
    Sample,
    detectable_difference,
    holm,
    mean_interval,
    permutation,
    smallest_p,
    verdict,
    welch,
)

RUNS = 1500
"""Simulated experiments; the standard error of a rate of 5 % is 0.6 %."""


def normal(rng, seeds):
    return rng.normal(size=seeds)


def bimodal(rng, seeds):
    """Success rates of seeds that master the task or fail, as on tabletop."""
    return np.where(rng.random(seeds) < 0.6, rng.normal(0.95, 0.05, seeds), rng.normal(0.1, 0.1, seeds)).clip(0, 1)


def rejections(draw, test, sizes, runs=RUNS):
    rng = np.random.default_rng(0)
    return np.mean([test(draw(rng, sizes[0]), draw(rng, sizes[1])) < 0.05 for _ in range(runs)])


def welch_p(scores, others):
    return welch(Sample.of(scores), Sample.of(others)).p


def permutation_p(scores, others):
    return permutation(scores, others).p


@pytest.mark.parametrize(("draw", "most"), [(normal, 0.06), (bimodal, 0.08)])
@pytest.mark.parametrize("sizes", [(5, 5), (10, 5)])
def test_equal_methods_are_told_apart_in_five_per_cent_of_the_experiments(draw, most, sizes):
    """Welch's test has 6.8 % on bimodal scores of ten and five seeds; the permutation test keeps its level on any scores."""
    assert 0.01 <= rejections(draw, welch_p, sizes) <= most
    assert 0.02 <= rejections(draw, permutation_p, sizes, runs=600) <= 0.07


def test_welch_equals_scipy():
    rng = np.random.default_rng(3)
    scores, others = rng.normal(0.3, 1.0, 5), rng.normal(0.0, 2.0, 9)
    result, expected = welch(Sample.of(scores), Sample.of(others)), stats.ttest_ind(scores, others, equal_var=False)
    assert result.p == pytest.approx(expected.pvalue)
    interval = expected.confidence_interval()
    assert (result.low, result.high) == pytest.approx((interval.low, interval.high))
    mean, expected = mean_interval(scores), stats.ttest_1samp(scores, 0.0).confidence_interval()
    assert (mean.low, mean.high) == pytest.approx((expected.low, expected.high))


def test_the_permutation_test_enumerates_few_seeds_and_draws_among_many():
    scores, others = np.array([1.0, 2.0, 3.0]), np.array([4.0, 5.0, 6.0])
    assert permutation(scores, others).p == pytest.approx(2 / 20)
    rng = np.random.default_rng(1)
    many, more = rng.normal(0.0, 1.0, 20), rng.normal(1.0, 1.0, 20)
    exact = stats.permutation_test((many, more), lambda a, b: a.mean() - b.mean(), n_resamples=20_000, rng=rng)
    assert permutation(many, more).p == pytest.approx(exact.pvalue, abs=0.005)
    assert permutation(many, many + 100).p == pytest.approx(1 / 20_001)


@pytest.mark.parametrize("sizes", [(2, 2), (5, 5), (4, 2), (5, 10), (10, 12)])
def test_the_smallest_p_is_that_of_seeds_without_overlap(sizes):
    seeds, others = sizes
    assert permutation(np.arange(seeds), 100.0 + np.arange(others)).p == pytest.approx(smallest_p(seeds, others))


def test_the_detectable_difference_is_found_in_four_of_five_experiments():
    rng = np.random.default_rng(0)
    size = detectable_difference(Sample(0.0, 1 / math.sqrt(5), 5), Sample(0.0, 1 / math.sqrt(5), 5))
    found = np.mean([welch_p(rng.normal(size, 1.0, 5), rng.normal(0.0, 1.0, 5)) < 0.05 for _ in range(RUNS)])
    assert found == pytest.approx(0.8, abs=0.03)


def test_holm_keeps_the_false_alarms_of_a_table_at_five_per_cent():
    np.testing.assert_allclose(holm([0.01, math.nan, 0.04, 0.03]), [0.03, math.nan, 0.06, 0.06])
    p = np.random.default_rng(0).random((RUNS, 27))
    alarms = np.mean([(holm(table) < 0.05).any() for table in p])
    assert 0.035 <= alarms <= 0.06
    assert np.mean((p < 0.05).any(axis=1)) > 0.7, "without a correction most tables have a false alarm"


def test_equal_constant_scores_do_not_differ_and_single_seeds_tell_nothing():
    ones, zeros = np.ones(5), np.zeros(5)
    assert permutation(ones, ones).p == 1.0
    assert math.isnan(welch(Sample.of(ones), Sample.of(zeros)).p), "no spread, no test"
    assert permutation(ones, zeros).p == pytest.approx(2 / 252)
    single = permutation(ones[:1], zeros)
    assert (single.difference, single.verdict) == (1.0, "cannot tell")
    assert math.isnan(single.p)
    assert math.isnan(detectable_difference(Sample.of(ones[:1]), Sample.of(zeros)))


def test_a_verdict_is_one_of_three():
    verdicts = [verdict(*result) for result in ((1.0, 0.01), (-1.0, 0.01), (1.0, 0.05), (1.0, math.nan))]
    assert verdicts == ["above", "below", "cannot tell", "cannot tell"]
