"""Two-sample tests and their correction, against numbers from the literature and by hand."""

import math

import numpy as np
import pytest

from earl_jax.metrics.comparisons import holm, welch


def test_welchs_test_of_two_small_groups():
    """By hand: variances 1 and 4, errors 1/3 and 4/3, degrees of freedom (5/3)^2 / ((1/9 + 16/9) / 2) = 50/17."""
    result = welch(np.array([1.0, 2.0, 3.0]), np.array([4.0, 6.0, 8.0]))
    assert result.value == -4
    assert result.p == pytest.approx(0.0545, abs=1e-3)
    assert (result.low + result.high) / 2 == pytest.approx(-4)
    assert result.high - result.low == pytest.approx(2 * 3.2208 * math.sqrt(5 / 3), rel=1e-3)


@pytest.mark.parametrize(("scores", "others"), [([1.0], [2.0, 3.0]), ([1.0, 1.0], [2.0, 2.0])])
def test_groups_without_a_spread_have_no_test(scores, others):
    result = welch(np.array(scores), np.array(others))
    assert result.value < 0
    assert all(map(math.isnan, result[1:]))


def test_holms_correction_keeps_the_order_and_leaves_out_what_was_not_tested():
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert holm([0.9, 0.8])[:2] == pytest.approx([1.0, 1.0])
    corrected = holm([math.nan, 0.02, 0.5])
    assert math.isnan(corrected[0])
    assert corrected[1:] == pytest.approx([0.04, 0.5])
