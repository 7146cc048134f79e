"""The numbers behind the plots of a page."""

import numpy as np

from earl_jax.report.html.curves import POINTS, banded, thinned


def test_long_curves_are_thinned_with_both_ends_kept():
    indices = thinned(10_000)
    assert len(indices) == POINTS
    assert (indices[0], indices[-1]) == (0, 9_999)
    assert thinned(7).tolist() == list(range(7))


def test_numbers_that_json_cannot_hold_become_null():
    assert banded(np.array([[1.0, np.nan]]))["mean"] == [1.0, None]


def test_a_band_needs_three_seeds():
    assert banded(np.ones((2, 1)))["low"] is None
    assert banded(np.ones((3, 1)))["low"] == [1.0]
