"""Both evaluations of lanes in training."""

import jax
import jax.numpy as jnp
import pytest

from earl_jax.algos.method import RETURN
from earl_jax.training.evaluation import deployed_lane, evaluate_lanes
from tests.conftest import advance, assert_equal_trees, make_train_state, take_lane, tiny_method


def test_a_deployed_evaluation_repeats_and_counts_whole_episodes(problem):
    method = tiny_method("naive")
    state = make_train_state(problem, method, [0, 1])
    lane_method, lane = take_lane((method, state.lanes), 0)
    first, second = (deployed_lane(problem, lane_method, lane, state.step) for _ in range(2))
    assert float(first["deployed/success"]) == float(second["deployed/success"])
    assert (float(first["deployed/success"]) * problem.protocol.eval_episodes) % 1 == 0


def test_an_evaluation_changes_nothing_but_the_reward_window(problem):
    method = tiny_method("naive")
    state = make_train_state(problem, method, [0, 1])
    counters = state.lanes.counters.replace(window_reward=jnp.array([3.0, 0.0]))
    state = state.replace(lanes=state.lanes.replace(counters=counters), step=jnp.asarray(40, jnp.int32))
    after, metrics = jax.jit(lambda m, state: evaluate_lanes(problem, m, state))(method, state)
    assert metrics["continuing/reward"].tolist() == pytest.approx([3 / 40, 0.0])
    closed = counters.replace(window_reward=jnp.zeros(2), total_reward=jnp.array([3.0, 0.0]))
    assert_equal_trees(after, state.replace(lanes=state.lanes.replace(counters=closed)))


def test_the_task_is_rewarded_whichever_controller_acts(env, problem):
    """A lane that stands on its task goal while the backward controller acts goes on earning."""
    method = tiny_method("fbrl", 1)
    state = make_train_state(problem, method, [0])
    goal = jnp.asarray(env.goal_states[1])
    env_state = state.lanes.env_state
    env_state = env_state.replace(
        data=env_state.data.replace(qpos=goal[None, :4]), obs=jnp.concatenate([goal, goal])[None]
    )
    goal_indices = state.lanes.goal_indices._replace(goal=jnp.array([4]), task=jnp.array([1]))
    lanes = state.lanes.replace(env_state=env_state, goal_indices=goal_indices, phase=jnp.array([RETURN]))
    after = advance(problem, method, state.replace(lanes=lanes), 1, explore=True)
    assert float(after.lanes.counters.window_reward[0]) == 1.0
    assert int(after.lanes.counters.reached[0]) == 0
    assert int(after.lanes.phase[0]) == RETURN
