"""Measures of a map by hand."""

import math

import numpy as np
import pytest

from earl_jax.metrics.visitation import measure


def test_a_map_is_measured_from_even_to_a_single_place():
    even, single, two = np.full((20, 20), 3), np.zeros((20, 20), int), np.zeros((20, 20), int)
    single[4, 5] = 7
    two[0, :2] = 5
    assert list(measure(even).values()) == pytest.approx([1, 1, 0.01])
    assert list(measure(single).values()) == pytest.approx([1 / 400, 0, 1])
    assert list(measure(two).values()) == pytest.approx([2 / 400, math.log(2) / math.log(400), 1])
    assert list(measure(0 * two).values()) == [0, 0, 0]
