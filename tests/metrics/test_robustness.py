"""Relative drops by hand."""

import math

import numpy as np
import pytest

from earl_jax.metrics.robustness import relative_drop


def test_a_drop_compares_means_and_its_interval_resamples_pairs():
    assert relative_drop(np.array([1.0, 0.5]), np.array([0.5, 0.25])) == pytest.approx((0.5, 0.5, 0.5))
    assert relative_drop(np.array([1.0, 0.0]), np.array([0.4, 0.0])) == pytest.approx((0.6, 0.6, 0.6))
    assert math.isnan(relative_drop(np.zeros(2), np.array([0.4, 0.0])).value)
