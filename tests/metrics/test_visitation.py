"""Measures of a map of visits, computed by hand."""

import math

import numpy as np
import pytest

from earl_jax.metrics.visitation import measure


def test_measures_of_an_even_map_a_single_bin_two_bins_and_no_visit():
    even, single, two = np.full((20, 20), 3), np.zeros((20, 20), int), np.zeros((20, 20), int)
    single[4, 5] = 7
    two[0, :2] = 5
    assert list(measure(even).values()) == pytest.approx([1, 1, 0.01])
    assert list(measure(single).values()) == pytest.approx([1 / 400, 0, 1])
    assert list(measure(two).values()) == pytest.approx([2 / 400, math.log(2) / math.log(400), 1])
    assert list(measure(0 * two).values()) == [0, 0, 0]
