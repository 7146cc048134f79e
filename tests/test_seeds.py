"""Tests of the seeds that the command line, sweep files and Python take, and of whole numbers as text."""

import numpy as np
import pytest

import earl_jax
from earl_jax.errors import InputError
from earl_jax.seeds import parse_seeds, parse_whole, seed_list


@pytest.mark.parametrize(
    ("text", "number"), [("1e6", 1_000_000), ("2_500_000", 2_500_000), ("2.50E6", 2_500_000), ("-3", -3), ("1e0", 1)]
)
def test_whole_numbers_can_have_an_exponent(text, number):
    assert parse_whole(text) == number
    assert isinstance(parse_whole(text), int)


@pytest.mark.parametrize("text", ["1.5", "2.55e1", "1e-3", "1e400", "1e19", "e6", "six", "", "nan", "1e", "9" * 5000])
def test_a_number_that_is_not_whole_or_too_large_is_refused(text):
    with pytest.raises(ValueError, match="whole number"):
        parse_whole(text)


@pytest.mark.parametrize(
    ("text", "seeds"), [("5", 5), ("5:10", [5, 6, 7, 8, 9]), ("3,5,8", [3, 5, 8]), ("1:3,8", [1, 2, 8]), ("4:5", [4])]
)
def test_seeds_are_a_count_a_range_or_a_list(text, seeds):
    parsed = parse_seeds(text)
    assert (parsed if isinstance(parsed, int) else list(parsed)) == seeds
    assert list(seed_list(text)) == (list(range(seeds)) if isinstance(seeds, int) else seeds)


@pytest.mark.parametrize("text", ["10:5", "5:5", "1:2:3", "a", "5:", ",", "", "0:99999999999,1"])
def test_other_seeds_are_refused(text):
    with pytest.raises(InputError, match=r"^seeds"):
        seed_list(text)


@pytest.mark.parametrize(
    ("seeds", "expected"), [(3, [0, 1, 2]), ([4, 2], [4, 2]), (np.array([5, 7]), [5, 7]), (range(2, 4), [2, 3])]
)
def test_seeds_of_python_are_a_number_or_a_list(seeds, expected):
    assert list(seed_list(seeds)) == expected


@pytest.mark.parametrize("seeds", [[0.5, 1], 2.0, None, ["3"]])
def test_seeds_that_are_not_whole_are_refused(seeds):
    with pytest.raises(InputError, match="seeds must be whole numbers"):
        seed_list(seeds)


def test_train_takes_a_range_as_text():
    with pytest.raises(InputError, match=r"seeds takes a count \(5\), a range \(5:10, without 10\)"):
        earl_jax.train("tabletop_organization", seeds="10:5")
    with pytest.raises(InputError, match="steps 100 is not a multiple"):  # the seeds were read
        earl_jax.train("tabletop_organization", seeds="5:10", steps=100, eval_every=30)
