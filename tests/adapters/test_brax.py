"""The brax adapter: its interface, and brax's wrappers."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax.envs.wrappers import training

from earl_jax.adapters.brax import ResetFreeEnv, wrap_for_training
from earl_jax.protocol import Deployment
from tests.adapters.test_gymnasium import STAY, TABLETOP, Fragile
from tests.conftest import assert_equal_trees

KEY = jax.random.PRNGKey(0)
MOVE = jnp.array([1.0, 0.0, -1.0])


def rollout(env, keys, steps, action=MOVE):
    """Return the last and all states of `steps` steps with one action after a reset, in one program."""

    def step(state, _):
        state = env.step(state, action)
        return state, state

    return jax.jit(lambda keys: jax.lax.scan(step, env.reset(keys), length=steps))(keys)


def test_raw_and_typed_keys_start_the_same_lifetime():
    env = ResetFreeEnv(TABLETOP)
    reset = jax.jit(env.reset)
    assert_equal_trees(reset(jax.random.PRNGKey(3)), reset(jax.random.key(3)))
    keys = [jax.random.key_data(reset(jax.random.PRNGKey(seed)).pipeline_state.key) for seed in (3, 4)]
    assert not np.array_equal(*keys)


def test_sizes_backend_and_interventions_of_a_lifetime():
    env = ResetFreeEnv(TABLETOP, train_horizon=4)
    assert (env.observation_size, env.action_size, env.backend) == (12, 3, "kinematic")
    _, states = rollout(env, KEY, 9)
    np.testing.assert_allclose(states.obs[:, 0], 0.2 * np.array([1, 2, 3, 0, 1, 2, 3, 0, 1]), atol=1e-6)
    np.testing.assert_array_equal(states.metrics["interventions"], [0, 0, 0, 1, 0, 0, 0, 1, 0])
    assert not states.done.any()


@pytest.mark.slow
def test_done_marks_a_fault_and_the_end_of_a_lifetime():
    fragile = ResetFreeEnv(Fragile(), mode="eval")
    _, states = rollout(fragile, KEY, 3)
    np.testing.assert_array_equal(states.done, [0, 0, 1])
    budget = ResetFreeEnv(TABLETOP, setting=Deployment(budget=2.0))
    _, states = rollout(budget, KEY, 3, jnp.array([0, 0, 0, 1.0]))
    np.testing.assert_array_equal(states.done, [0, 1, 1])


def test_braxs_wrappers_end_episodes_and_restore_state_and_goal():
    env = training.EvalWrapper(training.wrap(ResetFreeEnv(TABLETOP, mode="eval"), episode_length=5))
    state = jax.jit(env.reset)(jax.random.split(KEY, 3))
    first, step = state, jax.jit(env.step)
    goals = first.obs[:, 6:]
    for number in range(1, 11):
        state = step(state, jnp.tile(MOVE, (3, 1)))
        np.testing.assert_array_equal(state.done, number % 5 == 0)
        np.testing.assert_array_equal(state.pipeline_state.env_state.info["goal"], goals)
    np.testing.assert_array_equal(state.obs, first.obs)
    np.testing.assert_array_equal(state.info["truncation"], 1.0)
    assert set(state.info["eval_metrics"].episode_metrics) == {"reward", "success", "interventions"}


@pytest.mark.slow
def test_braxs_trainers_do_not_truncate_a_lifetime():
    for mode, done in (("train", 0.0), ("eval", 1.0)):
        env = wrap_for_training(ResetFreeEnv(TABLETOP, mode=mode), episode_length=3)
        final, _ = rollout(env, jax.random.split(KEY), 3, jnp.tile(MOVE, (2, 1)))
        np.testing.assert_array_equal(final.done, done)


def test_a_set_goal_stays_in_each_lane_until_the_choice_is_given_back():
    env = wrap_for_training(ResetFreeEnv(TABLETOP, attempt_steps=1), episode_length=3)
    set_goal, state = jax.jit(jax.vmap(env.unwrapped.set_goal)), jax.jit(env.reset)(jax.random.split(KEY))
    state = set_goal(state, state.obs[:, :6])
    for _ in range(2):
        state = jax.jit(env.step)(state, jnp.tile(STAY, (2, 1)))
        np.testing.assert_array_equal(state.reward, 1.0)
    given_back = set_goal(state)
    assert (given_back.obs[:, 6:] != state.obs[:, 6:]).any(axis=1).all()
