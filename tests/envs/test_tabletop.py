"""Tabletop against the recorded originals and against arithmetic by hand."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.envs import make
from earl_jax.envs.tabletop import COASTERS, FREE, HELD
from tests.envs.programs import first_state, program, starts

RECORDED = Path(__file__).parents[3] / "shared" / "reference_demos"


@pytest.mark.skipif(not RECORDED.is_dir(), reason="the recorded originals are not part of the project")
@pytest.mark.parametrize("direction", ["forward", "reverse"])
def test_replayed_recordings_of_the_original_give_its_observations_and_rewards(env, direction):
    with np.load(RECORDED / f"tabletop_manipulation_{direction}.npz") as demos:
        obs, actions, expected = demos["observations"], demos["actions"], demos["next_observations"]
        rewards, ends = demos["rewards"][:, 0], demos["terminals"][:, 0]

    def step(state, row):
        start, vector, action = row
        fresh = env.demonstrations.state_at(vector[:6], vector[6:])
        state = env.step(jax.tree.map(lambda new, old: jnp.where(start, new, old), fresh, state), action)
        return state, (state.obs, state.reward)

    rows = np.concatenate([[True], ends[:-1]]), obs, actions
    actual, actual_rewards = jax.jit(lambda state, rows: jax.lax.scan(step, state, rows)[1])(first_state(env), rows)
    assert np.abs(np.asarray(actual) - expected).max() <= 1e-6
    np.testing.assert_array_equal(actual_rewards, rewards)


def test_a_mug_is_held_when_near_and_gripped_and_stays_held_at_any_distance_up_to_the_walls(env):
    steps = [
        ([0.0, 0.0, 0.39, 0.0, *FREE], [0.5, 0.0, 1.0], [0.1, 0.0, 0.49, 0.0, *HELD]),
        ([0.0, 0.0, 0.4, 0.0, *FREE], [0.5, 0.0, 1.0], [0.1, 0.0, 0.4, 0.0, *FREE]),
        ([0.1, 0.0, 0.49, 0.0, *HELD], [0.5, 0.0, 0.0], [0.2, 0.0, 0.49, 0.0, *FREE]),
        ([2.75, 0.0, 2.0, 0.0, *HELD], [1.0, -1.0, 0.1], [2.8, -0.2, 2.05, -0.2, *HELD]),
    ]
    for before, action, after in steps:
        state = program(env, "demonstrations.state_at")(np.float32(before), env.goal_states[0])
        state = program(env, "step")(state, np.float32(action))
        np.testing.assert_allclose(state.obs[:6], after, atol=1e-6)


def test_success_requires_gripper_and_mug_together_unless_the_mug_counts_alone():
    gripper = [[0, 0], [0.19, 0], [0.14, 0], [0.15, 0], [0.25, 0], [2, 2], [2, 2]]
    mug = [[0, 2], [0, 2], [0, 2.14], [0, 2.15], [0, 2], [0, 1.9], [0, 1.7]]
    mug_alone = [1] * 6 + [0]
    for options, expected in (({}, [1] * 3 + [0] * 4), ({"mug_only": True}, mug_alone), ({"wide": True}, mug_alone)):
        env = make("tabletop_organization", **options)
        obs = np.hstack([gripper, mug, np.tile([*FREE, *env.goal_states[2]], (7, 1))]).astype(np.float32)
        assert program(env, "success")(obs).tolist() == expected


def test_dense_reward_is_the_released_formula():
    env = make("tabletop_organization", reward_type="dense")
    obs = np.array([0.3, -0.1, 0.5, 0.2, -1, -1, 0, 0, 0.45, 0.25, -1, -1], np.float32)
    goal, grip = np.hypot(0.05, 0.05), 0.5 * np.hypot(0.2, 0.3)
    expected = -goal + 2 * np.exp(-(goal**2) / 0.01) - grip + 0.5 * np.exp(-(grip**2) / 0.01)
    np.testing.assert_allclose(program(env, "reward")(obs), expected, rtol=1e-5)


def test_wide_starts_keep_their_distances():
    obs = np.asarray(starts(make("tabletop_organization", wide=True)).obs)
    assert np.linalg.norm(obs[:, :2] - obs[:, 2:4], axis=1).min() >= 1
    assert np.linalg.norm(obs[:, None, 2:4] - COASTERS, axis=-1).min() >= 1
    assert np.abs(obs[:, :4]).max() > 2.4
