"""Samples of options: their distributions, that a longer list begins with the shorter one, and the errors."""

import numpy as np
import pytest

from earl_jax.sweeps.samples import SAMPLERS, mapping, samples

OPTIONS = {
    "learning_rate": {"log_uniform": [1e-5, 1e-1]},
    "discount": {"uniform": [0.9, 0.999]},
    "batch_size": {"integers": [1, 4]},
    "hidden_sizes": {"choice": [[16], [32, 32]]},
}


@pytest.mark.parametrize("sampler", SAMPLERS)
def test_samples_follow_their_distributions(sampler):
    drawn = samples(OPTIONS, 1024, sampler, seed=1)
    columns = {name: [sample[name] for sample in drawn] for name in OPTIONS}
    rates = np.array(columns["learning_rate"])
    assert 1e-5 <= rates.min() < 2e-5
    assert 5e-2 < rates.max() <= 1e-1
    share = np.mean(rates < 1e-3)  # the middle of the exponents
    assert share == pytest.approx(0.5, abs=0.05)
    assert np.mean(columns["discount"]) == pytest.approx(0.9495, abs=0.004)
    counts = [columns["batch_size"].count(size) for size in range(1, 5)]
    assert sum(counts) == 1024
    assert min(counts) > 200
    assert 400 < columns["hidden_sizes"].count([16]) < 624
    assert all(float(f"{rate:.4g}") == rate for rate in rates)


@pytest.mark.parametrize("sampler", SAMPLERS)
def test_more_samples_begin_with_the_same_ones(sampler):
    few, many = (samples(OPTIONS, count, sampler, seed=2) for count in (5, 40))
    assert many[:5] == few
    assert samples(OPTIONS, 5, sampler, seed=3) != few


def test_sobol_points_are_spread_evenly():
    drawn = samples({"x": {"integers": [0, 15]}}, 16, "sobol")
    assert sorted(sample["x"] for sample in drawn) == list(range(16))


def test_rounding_stays_within_the_ends():
    last = mapping("discount", {"uniform": [0.1, 0.99999]})
    assert last(1 - 1e-9) == 0.99999
    assert last(0.0) == 0.1


@pytest.mark.parametrize(
    ("distribution", "message"),
    [
        ({"normal": [0, 1]}, "must be one of uniform, log_uniform, integers, choice"),
        ({"uniform": [0, 1], "choice": [1]}, "must be one of"),
        ({"uniform": [1, 0]}, "two numbers, the smaller one first"),
        ({"uniform": [0, float("inf")]}, "two numbers"),
        ({"uniform": [0, True]}, "two numbers"),
        ({"log_uniform": [0, 1]}, "both above 0"),
        ({"integers": [1, 2.5]}, "both whole"),
        ({"choice": []}, "a list of values"),
    ],
)
def test_invalid_distributions_name_the_option(distribution, message):
    with pytest.raises(ValueError, match=f"option x.*{message}"):
        samples({"x": distribution}, 3)


def test_invalid_numbers_and_samplers_are_named():
    for arguments, message in (
        ((0,), "samples must"),
        ((True,), "samples must"),
        ((3, "grid"), "choose from random, sobol"),
    ):
        with pytest.raises(ValueError, match=message):
            samples(OPTIONS, *arguments)
    with pytest.raises(ValueError, match="sample_seed must be a whole number from 0"):
        samples(OPTIONS, 3, seed=-1)
