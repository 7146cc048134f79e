"""Tests of option checks: known names, values of the default's type, and messages with the valid choices."""

import dataclasses
import re

import numpy as np
import pytest

from earl_jax.options import check


@dataclasses.dataclass
class Example:
    rate: float = 0.5
    size: int = 8
    fast: bool = False
    word: str = "a"
    layers: tuple[int, ...] = (8,)
    limit: float | None = None


@pytest.mark.parametrize(
    "options",
    [
        {"rate": 1}, {"rate": np.array([0.1, 0.2])}, {"size": np.int64(3)}, {"fast": True}, {"fast": np.array([1.0, 0.0])},
        {"layers": (4, 4)}, {"limit": None}, {"limit": 2.0}, {"word": "b"},
    ],
)  # fmt: skip
def test_values_of_the_right_type_are_accepted(options):
    check("example", Example, options)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"speed": 1}, "example has no option 'speed'; choose from rate, size, fast, word, layers, limit"),
        ({"rate": "fast"}, "rate must be a finite number, not 'fast'"),
        ({"rate": float("nan")}, "rate must be a finite number"),
        ({"rate": True}, "rate must be a finite number"),
        ({"size": 2.5}, "size must be a whole number of at least 0, not 2.5"),
        ({"size": -1}, "size must be a whole number"),
        ({"fast": "no"}, "fast must be true or false, not 'no'"),
        ({"word": 3}, "word must be text, not 3"),
        ({"layers": ()}, "layers must be whole numbers of at least 1"),
        ({"layers": (8, 0)}, "layers must be whole numbers of at least 1"),
        ({"limit": "much"}, "limit must be a finite number, not 'much'"),
    ],
)
def test_unknown_options_and_wrong_types_are_refused(options, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        check("example", Example, options)
