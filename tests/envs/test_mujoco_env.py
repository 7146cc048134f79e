"""The parts that tasks with a MuJoCo model share."""

import jax
import numpy as np
import pytest

from earl_jax.envs.mujoco_env import leashed_target

SPEEDS, LENGTHS = np.array([1.0, 4.0], np.float32), np.array([0.2, 0.08], np.float32)


@pytest.mark.parametrize("fastest", [0.0, 1.0, 2.5, 4.0, 9.0])
def test_a_target_leads_the_hand_by_a_length_that_depends_on_the_fastest_joint(fastest):
    target, hand = np.array([1.0, 0.5, 0.0], np.float32), np.array([0.1, 0.5, 0.0], np.float32)
    pulled = jax.jit(leashed_target)(target, hand, np.float32(fastest), SPEEDS, LENGTHS)
    length = np.interp(fastest, SPEEDS, LENGTHS)
    np.testing.assert_allclose(pulled, hand + np.array([length, 0, 0]), atol=1e-6)
    near = hand + np.float32([0.5 * length, 0, 0])
    np.testing.assert_array_equal(leashed_target(near, hand, np.float32(fastest), SPEEDS, LENGTHS), near)
