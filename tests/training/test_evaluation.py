"""Both evaluations of lanes in training."""

import jax.numpy as jnp
import pytest

from earl_jax.algos.method import RETURN
from tests.conftest import advance, assert_equal_trees, evaluate, make_train_state, tiny_method


def test_an_evaluation_repeats_and_changes_nothing_but_the_reward_window(problem):
    method = tiny_method("naive")
    state = make_train_state(problem, method, [0, 1])
    counters = state.lanes.counters.replace(window_reward=jnp.array([3.0, 0.0]))
    state = state.replace(lanes=state.lanes.replace(counters=counters), step=jnp.asarray(40, jnp.int32))
    after, metrics = evaluate(problem, method, state)
    assert metrics["continuing/reward"].tolist() == pytest.approx([3 / 40, 0.0])
    closed = counters.replace(window_reward=jnp.zeros(2), total_reward=jnp.array([3.0, 0.0]))
    assert_equal_trees(after, state.replace(lanes=state.lanes.replace(counters=closed)))
    again = evaluate(problem, method, after)[1]
    assert again["deployed/success"].tolist() == metrics["deployed/success"].tolist()
    assert again["deployed/return"].tolist() == metrics["deployed/return"].tolist()


def test_the_task_is_rewarded_whichever_controller_acts(env, problem):
    """A lane that stands on its task goal while the backward controller acts goes on earning."""
    method = tiny_method("fbrl")
    state = make_train_state(problem, method, [0, 1])
    goal = jnp.asarray(env.goal_states[1])
    env_state = state.lanes.env_state
    env_state = env_state.replace(
        data=env_state.data.replace(qpos=jnp.tile(goal[:4], (2, 1))), obs=jnp.tile(goal, (2, 2))
    )
    goal_indices = state.lanes.goal_indices._replace(goal=jnp.array([4, 4]), task=jnp.array([1, 1]))
    lanes = state.lanes.replace(env_state=env_state, goal_indices=goal_indices, phase=jnp.array([RETURN, RETURN]))
    after = advance(problem, method, state.replace(lanes=lanes), 1, explore=True)
    assert after.lanes.counters.window_reward.tolist() == [1.0, 1.0]
    assert after.lanes.counters.reached.tolist() == [0, 0]
    assert after.lanes.phase.tolist() == [RETURN, RETURN]
