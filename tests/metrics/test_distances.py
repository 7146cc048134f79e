"""Distances and shares of visits on maps whose answers are computed by hand."""

import jax
import numpy as np
import pytest

from earl_jax.metrics.distances import bin_centres, mean_distance, share_in_corners, share_near

BOUNDS = np.array([[0.0, 10.0], [20.0, 30.0]])
"""A map with bins of one unit, if it has twenty a side."""


def visits_at(*counts):
    """Return visits [20, 20] of (x bin, y bin, count)."""
    visits = np.zeros((20, 20), int)
    for x, y, count in counts:
        visits[x, y] = count
    return visits


def test_bins_have_their_centres_with_x_first():
    centres = bin_centres(BOUNDS, 20)
    np.testing.assert_allclose(centres[0, 0], [0.5, 10.5])
    np.testing.assert_allclose(centres[19, 0], [19.5, 10.5])


def test_the_distance_is_to_the_nearest_place_weighted_by_visits():
    visits = visits_at((0, 0, 3), (4, 3, 1))
    near, far = [0.5, 10.5], [4.5, 23.5]
    assert mean_distance(visits, BOUNDS, np.array([near])) == pytest.approx(5 / 4)
    assert mean_distance(visits, BOUNDS, np.array([near, [4.5, 14.5]])) == pytest.approx(1 / 4)
    assert mean_distance(np.stack([visits, 2 * visits, 0 * visits]), BOUNDS, np.array([near, far])) == pytest.approx(
        [5 / 4, 5 / 4, 0]
    )


def test_shares_near_a_place_and_in_the_corners():
    visits = visits_at((1, 18, 2), (2, 18, 1), (10, 10, 4), (19, 0, 1))
    assert share_in_corners(visits) == pytest.approx(3 / 8)
    assert share_near(visits, BOUNDS, np.array([[10.5, 22.5]]), 2.0) == pytest.approx(4 / 8)
    assert share_near(visits, BOUNDS, np.array([[10.5, 22.5]]), 1.9) == 0
    assert share_in_corners(np.ones((20, 20))) == pytest.approx(16 / 400)


def test_the_measures_can_be_traced():
    visits = visits_at((1, 18, 2), (10, 10, 4))
    traced = jax.jit(lambda v: (share_in_corners(v), mean_distance(v, BOUNDS, np.array([[0.5, 10.5]]))))(visits)
    np.testing.assert_allclose(traced, [share_in_corners(visits), mean_distance(visits, BOUNDS, [[0.5, 10.5]])], 1e-6)
