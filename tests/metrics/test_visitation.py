"""Measures of maps of visits by hand, and inside `jit` and `vmap` against NumPy."""

import math

import jax
import numpy as np
import pytest

from earl_jax.metrics.visitation import mean_distance, measure, share_in_corners, share_near

BOUNDS = np.array([[0.0, 10.0], [20.0, 30.0]])
"""A map with bins of one unit, if it has twenty a side."""


def visits_at(*counts):
    """Return visits [20, 20] of (x bin, y bin, count)."""
    visits = np.zeros((20, 20), int)
    for x, y, count in counts:
        visits[x, y] = count
    return visits


def test_measures_of_an_even_map_a_single_bin_two_bins_and_no_visit():
    even, single, two = np.full((20, 20), 3), visits_at((4, 5, 7)), visits_at((0, 0, 5), (0, 1, 5))
    assert list(measure(even).values()) == pytest.approx([1, 1, 0.01])
    assert list(measure(single).values()) == pytest.approx([1 / 400, 0, 1])
    assert list(measure(two).values()) == pytest.approx([2 / 400, math.log(2) / math.log(400), 1])
    assert list(measure(0 * two).values()) == [0, 0, 0]


def test_the_distance_is_to_the_nearest_place_weighted_by_visits():
    visits = visits_at((0, 0, 3), (4, 3, 1))
    near, far = [0.5, 10.5], [4.5, 23.5]
    assert mean_distance(visits, BOUNDS, np.array([near])) == pytest.approx(5 / 4)
    assert mean_distance(visits, BOUNDS, np.array([near, [4.5, 14.5]])) == pytest.approx(1 / 4)
    several = np.stack([visits, 2 * visits, 0 * visits])
    assert mean_distance(several, BOUNDS, np.array([near, far])) == pytest.approx([5 / 4, 5 / 4, 0])


def test_shares_near_a_place_and_in_the_corners():
    visits = visits_at((1, 18, 2), (2, 18, 1), (10, 10, 4), (19, 0, 1))
    assert share_in_corners(visits) == pytest.approx(3 / 8)
    assert share_near(visits, BOUNDS, np.array([[10.5, 22.5]]), 2.0) == pytest.approx(4 / 8)
    assert share_near(visits, BOUNDS, np.array([[10.5, 22.5]]), 1.9) == 0
    assert share_in_corners(np.ones((20, 20))) == pytest.approx(16 / 400)


def test_measures_of_a_batch_of_maps_in_one_program_equal_numpys():
    visits = np.random.default_rng(0).poisson(0.7, (3, 16, 16))
    visits[1], visits[2, 1:] = 0, 0

    def every_measure(visits):
        return {
            **measure(visits),
            "corners": share_in_corners(visits),
            "distance": mean_distance(visits, BOUNDS, np.array([[0.5, 10.5]])),
        }

    actual = jax.jit(jax.vmap(every_measure))(visits)
    assert actual["covered"].tolist()[1] == 0
    expected = [every_measure(single) for single in visits]
    for name, values in actual.items():
        np.testing.assert_allclose(values, [single[name] for single in expected], rtol=1e-6, err_msg=name)
