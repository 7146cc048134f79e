"""J_D, D(A) and C(A) against sums by hand."""

import numpy as np
import pytest

from earl_jax.metrics.scores import deployed_area, lifetime_scores, regret

STEPS, SCORES = np.array([10, 30]), np.array([[1.0, 0.5], [0.0, 0.3]])


def test_the_area_weights_an_evaluation_by_the_steps_before_it():
    np.testing.assert_allclose(deployed_area(STEPS, SCORES), [2 / 3, 0.2])


def test_regret_is_the_sum_of_gaps_to_the_optimum():
    gaps = np.repeat(1.0 - SCORES, [10, 20], axis=1)
    np.testing.assert_allclose(regret(STEPS, SCORES, 1.0), gaps.sum(axis=1))


def test_a_lifetime_has_three_scores():
    metrics = {"deployed/success": SCORES, "continuing/reward": np.array([[0.1, 0.2], [0.0, 0.4]])}
    scores = lifetime_scores(STEPS, metrics, "deployed/success")
    assert scores.final.tolist() == [0.5, 0.3]
    assert scores.deployed == pytest.approx([2 / 3, 0.2])
    assert scores.continuing.tolist() == [0.2, 0.4]
