"""Tests of metrics/comparison.py. Rates of false alarms and coverage are simulated: five per cent has to mean five."""

import math
import warnings

import numpy as np
import pytest
from scipy import stats

from earl_jax.metrics.comparison import (
    Sample,
    band,
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


@pytest.mark.parametrize(("draw", "most"), [(normal, 0.06), (bimodal, 0.08)])
@pytest.mark.parametrize("sizes", [(5, 5), (10, 5)])
def test_equal_methods_are_told_apart_in_five_per_cent_of_the_experiments(draw, most, sizes):
    """Welch's test has 6.8 % on bimodal scores of ten and five seeds; the permutation test keeps its level on any scores."""
    assert 0.01 <= rejections(draw, welch_p, sizes) <= most
    assert 0.02 <= rejections(draw, lambda *sides: permutation(*sides).p, sizes, runs=600) <= 0.07


def test_welch_equals_scipy():
    rng = np.random.default_rng(3)
    scores, others = rng.normal(0.3, 1.0, 5), rng.normal(0.0, 2.0, 9)
    result, expected = welch(Sample.of(scores), Sample.of(others)), stats.ttest_ind(scores, others, equal_var=False)
    assert result.p == pytest.approx(expected.pvalue)
    interval = expected.confidence_interval()
    assert (result.low, result.high) == pytest.approx((interval.low, interval.high))
    mean, expected = mean_interval(scores), stats.ttest_1samp(scores, 0.0).confidence_interval()
    assert (mean.low, mean.high) == pytest.approx((expected.low, expected.high))


WORLDS = {
    "all or nothing, 0.9": (0.9, lambda rng, shape: rng.random(shape) < 0.9),
    "all or nothing, 0.5": (0.5, lambda rng, shape: rng.random(shape) < 0.5),
    "evenly spread": (0.5, lambda rng, shape: rng.random(shape)),
    "near the end": (5 / 6, lambda rng, shape: rng.beta(5, 1, shape)),
    "at both ends": (0.5, lambda rng, shape: rng.beta(0.5, 0.5, shape)),
    "equal seeds, 100 episodes": (0.98, lambda rng, shape: rng.binomial(100, 0.98, shape) / 100),
    "one in ten fails a bit": (0.95, lambda rng, shape: np.where(rng.random(shape) < 0.9, 1.0, rng.random(shape))),
}
"""How success rates of seeds may be distributed, with their mean."""


@pytest.mark.parametrize("name", WORLDS)
@pytest.mark.parametrize("seeds", [3, 5, 10])
def test_the_interval_of_a_rate_holds_its_mean_in_19_of_20_experiments_and_stays_within_0_and_1(name, seeds):
    """Student's interval has 26 to 98 % here; it leaves [0, 1], or has no width where the few seeds agree."""
    mean, draw = WORLDS[name]
    scores = draw(np.random.default_rng(0), (seeds, 20_000)).astype(float)
    estimate = mean_interval(scores, rate=True)
    assert 0 <= estimate.low.min() <= estimate.high.max() <= 1
    assert np.mean((estimate.low <= mean) & (mean <= estimate.high)) > 0.928


def test_no_interval_knows_of_failures_that_five_seeds_did_not_show():
    rng = np.random.default_rng(0)
    failing = rng.random((5, 20_000)) < 0.15
    scores = np.where(failing, rng.beta(1, 3, failing.shape), rng.beta(30, 1.5, failing.shape))
    mean = 0.15 * 0.25 + 0.85 * 30 / 31.5
    held = [
        np.mean((low <= mean) & (mean <= high)) for _, low, high in (mean_interval(scores, r) for r in (True, False))
    ]
    assert held == [pytest.approx(0.63, abs=0.01), pytest.approx(0.58, abs=0.01)]


def test_the_interval_of_seeds_that_succeed_or_fail_is_wilsons_for_as_many_trials():
    level = 2 * stats.norm.cdf(stats.t.ppf(0.975, 4)) - 1  # the quantile is Student's
    expected = stats.binomtest(3, 5).proportion_ci(level, "wilson")
    assert mean_interval(np.array([0.0, 0, 1, 1, 1]), rate=True)[1:] == pytest.approx((expected.low, expected.high))


def test_an_interval_needs_three_seeds_and_a_band_has_no_width_where_seeds_agree():
    assert mean_interval(np.ones(5), rate=True).low == pytest.approx(5 / (5 + stats.norm.ppf(0.975) ** 2))
    assert np.isnan(mean_interval(np.array([0.2, 0.4]))[1:]).all()
    curves = np.array([[0.0, 0.1], [0.0, 0.5], [0.0, 0.2]])
    flat, risen = np.transpose(band(curves, rate=True))
    assert flat.tolist() == [0, 0, 0]
    assert risen.tolist() == pytest.approx(mean_interval(curves[:, 1], rate=True))
    assert np.isnan(band(curves[:2], rate=True).low).all()


def test_an_interval_and_a_band_of_tiny_rates_that_differ_are_tiny():
    rates = np.zeros(10)
    rates[3] = 9e-6  # one seed earned twice in 220,000 steps
    assert 9e-7 < mean_interval(rates, rate=True).high < 1e-4
    assert 9e-7 < band(rates[:, None], rate=True).high.item() < 1e-4


def test_a_band_has_no_ends_where_a_value_is_infinite():
    with warnings.catch_warnings(action="error"):
        mean, low, high = band(np.array([[1.0, math.inf], [2.0, 2.0], [3.0, 3.0]]))
    assert mean.tolist() == [2.0, math.inf]
    assert np.isnan([low, high]).tolist() == [[False, True]] * 2


def test_the_permutation_test_enumerates_few_seeds_and_draws_among_many():
    scores, others = np.array([1.0, 2.0, 3.0]), np.array([4.0, 5.0, 6.0])
    assert permutation(scores, others).p == pytest.approx(2 / 20)
    rng = np.random.default_rng(1)
    many, more = rng.normal(0.0, 1.0, 20), rng.normal(1.0, 1.0, 20)
    exact = stats.permutation_test((many, more), lambda a, b: a.mean() - b.mean(), n_resamples=20_000, rng=rng)
    assert permutation(many, more).p == pytest.approx(exact.pvalue, abs=0.005)
    assert permutation(many, many + 100).p == pytest.approx(1 / 20_001)
    rounded = np.array([0.90000004, 0.0, 1.0])  # nine of ten episodes, as float32 has them
    assert permutation(np.array([0.4, 0.5, 0.7]), rounded).p == pytest.approx(18 / 20)
    diverged = np.array([4.0, 5.0, 1e9])  # the size of one score makes no ties among the others
    assert permutation(scores, diverged).p == pytest.approx(2 / 20)


def test_a_side_with_fewer_seeds_and_a_larger_spread_is_not_told_apart_too_often():
    """By the difference of the means alone it was in a fifth of the experiments."""
    rng = np.random.default_rng(0)
    found = [permutation(rng.normal(0, 0.1, 10), rng.normal(0, 0.3, 5)).p < 0.05 for _ in range(600)]
    assert 0.03 <= np.mean(found) <= 0.1


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
    np.testing.assert_allclose(holm([0.01, 0.04], tests=3), [0.03, 0.08])
    p = np.random.default_rng(0).random((RUNS, 27))
    alarms = np.mean([(holm(table) < 0.05).any() for table in p])
    assert 0.035 <= alarms <= 0.06
    assert np.mean((p < 0.05).any(axis=1)) > 0.7, "without a correction most tables have a false alarm"


def test_equal_constant_scores_do_not_differ_and_single_or_infinite_ones_tell_nothing():
    ones, zeros = np.ones(5), np.zeros(5)
    assert permutation(ones, ones).p == 1.0
    assert math.isnan(welch(Sample.of(ones), Sample.of(zeros)).p), "no spread, no test"
    assert permutation(ones, zeros).p == pytest.approx(2 / 252)
    for scores in (ones[:1], np.array([0.1, math.inf, 0.2])):
        untested = permutation(scores, zeros)
        assert (untested.difference, untested.verdict) == (scores.mean(), "cannot tell")
        assert math.isnan(untested.p)
    pair = permutation(np.array([0.2, 0.6]), zeros)
    assert pair.p == pytest.approx(1 / 21), "two seeds have a test, but no interval"
    assert np.isnan([pair.low, pair.high]).all()
    for few in (ones[:1], np.array([0.2, 0.6])):
        assert math.isnan(detectable_difference(Sample.of(few), Sample.of(zeros)))
        assert math.isnan(welch(Sample.of(zeros), Sample.of(few)).low)


def test_a_verdict_is_one_of_three():
    verdicts = [verdict(*result) for result in ((1.0, 0.01), (-1.0, 0.01), (1.0, 0.05), (1.0, math.nan))]
    assert verdicts == ["above", "below", "cannot tell", "cannot tell"]
