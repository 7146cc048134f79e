"""J_D, D(A) and C(A) against sums by hand."""

import numpy as np
import pytest

from earl_jax.metrics.scores import deployed_area, judged, regret

STEPS, SCORES = np.array([10, 30]), np.array([[1.0, 0.5], [0.0, 0.3]])


def test_the_area_weighs_an_evaluation_by_the_steps_before_it():
    np.testing.assert_allclose(deployed_area(STEPS, SCORES), [2 / 3, 0.2])


def test_regret_is_the_sum_of_gaps_to_the_optimum():
    gaps = np.concatenate(
        [np.repeat(1.0 - SCORES[:, :1], 10, axis=1), np.repeat(1.0 - SCORES[:, 1:], 20, axis=1)], axis=1
    )
    np.testing.assert_allclose(regret(STEPS, SCORES, 1.0), gaps.sum(axis=1))


def test_a_life_is_judged_three_ways():
    metrics = {"deployed/success": SCORES, "continuing/reward": np.array([[0.1, 0.2], [0.0, 0.4]])}
    found = judged(STEPS, metrics, "deployed/success")
    assert found.final.tolist() == [0.5, 0.3]
    assert found.deployed == pytest.approx([2 / 3, 0.2])
    assert found.continuing.tolist() == [0.2, 0.4]
