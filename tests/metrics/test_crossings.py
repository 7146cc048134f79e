"""Tests of metrics/crossings.py."""

import math

import numpy as np
import pytest

from earl_jax.metrics.crossings import crossing, trailing_mean

STEPS = np.arange(10_000, 1_000_001, 10_000)


def test_the_window_is_measured_in_steps():
    ramp = np.linspace(0.01, 1.0, 100)
    means = trailing_mean(STEPS, ramp)
    assert np.isnan(means[:9]).all()
    assert means[9] == pytest.approx(ramp[:10].mean())
    assert means[-1] == pytest.approx(ramp[-10:].mean())
    np.testing.assert_allclose(trailing_mean(STEPS[1::2], ramp[1::2])[-1], ramp[-9::2].mean())


def test_a_crossing_is_that_of_the_mean_curve_and_nan_where_none_is():
    scores = np.stack([STEPS >= 300_000, STEPS >= 500_000]).astype(float)
    assert crossing(STEPS, scores, 0.5).value == 390_000
    assert crossing(STEPS, scores, 0.9).value == 570_000
    assert math.isnan(crossing(STEPS, scores, 1.1).value)
    single = crossing(STEPS, scores[:1], 0.5)
    assert (single.value, math.isnan(single.low), math.isnan(single.high)) == (340_000, True, True)


def test_the_interval_of_five_seeds_holds_the_crossing_of_the_population():
    """Seeds take off at a random step; an evaluation is the mean of ten episodes."""
    rng = np.random.default_rng(0)

    def scores(seeds):
        starts = rng.normal(400_000, 80_000, (seeds, 1))
        return rng.binomial(10, 1 / (1 + np.exp((starts - STEPS) / 40_000))) / 10

    true = crossing(STEPS, scores(5000), 0.5).value
    intervals = [crossing(STEPS, scores(5), 0.5) for _ in range(300)]
    inside = [interval.low <= true and not interval.high < true for interval in intervals]
    assert np.mean(inside) >= 0.93
    assert np.mean([interval.low > 100_000 for interval in intervals]) > 0.9, "the interval says something"
