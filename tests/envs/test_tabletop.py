"""Tabletop against the recorded originals and against arithmetic by hand."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax import assets
from earl_jax.envs import make
from earl_jax.envs.tabletop import COASTERS, FREE, HELD

RECORDED = Path(__file__).parents[3] / "shared" / "reference_demos"


def start_state(env, vector, goal):
    return env.state_from_demo(jnp.asarray(vector, jnp.float32), jnp.asarray(goal))


def replay(env, states, goals, actions, ends):
    """Return observations and rewards [T] of actions replayed open loop; every episode begins at its recorded start."""
    starts = np.concatenate([[True], ends[:-1]])
    first = start_state(env, states[0], goals[0])

    def step(state, row):
        vector, goal, action, start = row
        fresh = start_state(env, vector, goal)
        state = jax.tree.map(lambda new, old: jnp.where(start, new, old), fresh, state)
        state = env.step(state, action)
        return state, (state.obs, state.reward)

    return jax.lax.scan(step, first, (states, goals, actions, starts))[1]


@pytest.mark.skipif(not RECORDED.is_dir(), reason="the recorded originals are not part of the project")
@pytest.mark.parametrize("direction", ["forward", "reverse"])
def test_replayed_recordings_of_the_original_give_its_observations_and_rewards(env, direction):
    with np.load(RECORDED / f"tabletop_manipulation_{direction}.npz") as demos:
        obs, actions, expected = demos["observations"], demos["actions"], demos["next_observations"]
        rewards, ends = demos["rewards"][:, 0], demos["terminals"][:, 0]
    actual, actual_rewards = replay(env, obs[:, :6], obs[:, 6:], actions, ends)
    assert np.abs(np.asarray(actual) - expected).max() <= 1e-6
    np.testing.assert_array_equal(actual_rewards, rewards)


@pytest.mark.parametrize("direction", assets.DIRECTIONS)
def test_replayed_demonstrations_give_their_states_and_rewards(env, direction):
    demos = assets.demos("tabletop_organization", direction)
    obs, rewards = replay(env, demos.states, demos.goals, demos.actions, demos.ends)
    assert np.abs(np.asarray(obs)[:, :6] - demos.next_states).max() <= 1e-6
    np.testing.assert_array_equal(rewards, demos.rewards)


def test_the_mug_is_held_only_when_near_and_gripped(env):
    goal = env.goal_states[0]
    near, far, grip = [0.0, 0.0, 0.39, 0.0, *FREE], [0.0, 0.0, 0.4, 0.0, *FREE], jnp.array([0.5, 0.0, 1.0])
    held = env.step(start_state(env, near, goal), grip)
    np.testing.assert_allclose(held.obs[:6], [0.1, 0.0, 0.49, 0.0, *HELD], atol=1e-6)
    free = env.step(start_state(env, far, goal), grip)
    np.testing.assert_allclose(free.obs[:6], [0.1, 0.0, 0.4, 0.0, *FREE], atol=1e-6)
    dropped = env.step(held, jnp.array([0.5, 0.0, 0.0]))
    np.testing.assert_allclose(dropped.obs[:6], [0.2, 0.0, 0.49, 0.0, *FREE], atol=1e-6)


def test_a_held_mug_stays_held_at_any_distance_and_walls_stop_gripper_and_mug(env):
    held = start_state(env, [2.75, 0.0, 2.0, 0.0, *HELD], env.goal_states[0])
    after = env.step(held, jnp.array([1.0, -1.0, 0.1]))
    np.testing.assert_allclose(after.obs[:6], [2.8, -0.2, 2.05, -0.2, *HELD], atol=1e-6)


def test_success_requires_gripper_and_mug_together(env):
    def success(gripper, mug):
        goal = env.goal_states[2]
        return bool(env.success(jnp.asarray([*gripper, *mug, *FREE, *goal], jnp.float32)))

    assert success((0, 0), (0, 2))
    assert success((0.19, 0), (0, 2))
    assert success((0.14, 0), (0, 2.14))
    assert not success((0.15, 0), (0, 2.15))
    assert not success((0.25, 0), (0, 2))


def test_success_can_count_the_mug_alone_from_the_usual_start():
    env = make("tabletop_organization", mug_only=True)
    state = start_state(env, [2.0, 2.0, 0.0, 1.9, *FREE], env.goal_states[2])
    assert bool(env.success(state.obs))
    assert not bool(make("tabletop_organization").success(state.obs))
    assert not bool(env.success(state.obs.at[3].set(1.7)))
    np.testing.assert_array_equal(env.reset(jax.random.key(0)).obs[:6], env.initial_states[0])


def test_dense_reward_is_the_released_formula():
    env = make("tabletop_organization", reward_type="dense")
    obs = np.array([0.3, -0.1, 0.5, 0.2, -1, -1, 0, 0, 0.45, 0.25, -1, -1], np.float32)
    goal, grip = np.hypot(0.05, 0.05), 0.5 * np.hypot(0.2, 0.3)
    expected = -goal + 2 * np.exp(-(goal**2) / 0.01) - grip + 0.5 * np.exp(-(grip**2) / 0.01)
    np.testing.assert_allclose(env.reward(jnp.asarray(obs)), expected, rtol=1e-5)


def test_wide_starts_keep_their_distances_and_success_requires_the_mug_alone():
    env = make("tabletop_organization", wide=True)
    obs = np.asarray(jax.vmap(lambda key: env.reset(key).obs)(jax.random.split(jax.random.key(0), 500)))
    assert np.linalg.norm(obs[:, :2] - obs[:, 2:4], axis=1).min() >= 1
    assert np.linalg.norm(obs[:, None, 2:4] - COASTERS, axis=-1).min() >= 1
    assert np.abs(obs[:, :4]).max() > 2.4
    away = jnp.asarray([2.0, 2.0, 0.0, 1.9, *FREE, *env.goal_states[2]], jnp.float32)
    assert bool(env.success(away))


def test_the_expert_reaches_every_goal(env):
    def step(state, _):
        state = env.step(state, env.expert(state.obs))
        return state, state.reward

    for goal in env.goal_states:
        state = env.with_goal(env.reset(jax.random.key(0)), jnp.asarray(goal))
        _, rewards = jax.lax.scan(step, state, length=60)
        assert 25 < int(np.argmax(rewards)) < 55
        assert rewards.max() == 1
