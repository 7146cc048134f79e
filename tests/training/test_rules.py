"""Rules as data of the training loop: interventions, goals set by the environment, the absorbing end, and the map."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.algos.learner.replay import unpack
from earl_jax.algos.method import RETURN, TASK
from earl_jax.envs import make
from earl_jax.protocol import Deployment, Rules
from earl_jax.training import loop
from earl_jax.training.scan import run_steps
from earl_jax.training.state import MAP_BINS, Problem
from tests.conftest import advance, assert_equal_trees, make_train_state, take_lane, tiny_method


def lane_rules(horizon, chance, goal_change):
    return Rules(jnp.array(horizon), jnp.array(chance, jnp.float32), jnp.array(goal_change))


def test_lanes_of_one_program_follow_their_own_rules(problem):
    method = tiny_method("naive")
    rules = lane_rules([0, 20], [0.1, 0.0], [0, 0])
    start = make_train_state(problem, method, [0, 1], 200, rules)
    state = advance(problem, method, start, 200, explore=True)
    by_chance, by_horizon = np.asarray(state.lanes.counters.interventions)
    assert by_horizon == 10
    assert 8 <= by_chance <= 34
    method, rules = tiny_method("naive", 1), lane_rules([20], [0.0], [0])
    alone = advance(problem, method, make_train_state(problem, method, [1], 200, rules), 200, explore=True)
    assert_equal_trees(take_lane(state.lanes.env_state, slice(1, None)), alone.lanes.env_state)


@pytest.mark.parametrize("algo", ["naive", "fbrl"])
def test_goals_that_the_environment_sets_change_by_the_clock_alone(env, problem, monkeypatch, algo):
    """An attempt at the task follows a goal change at once; a return goes on to its own end."""
    monkeypatch.setattr(
        loop, "_act", lambda problem, method, lane, key, explore: problem.env.expert(lane.env_state.obs)
    )
    method, tasks = tiny_method(algo), []
    rules = lane_rules([0, 0], [0.0, 0.0], [100, 100])
    state = make_train_state(problem, method, [0, 1], 400, rules)
    run = jax.jit(lambda m, state: run_steps(problem, m, state, 25, explore=True))
    for _ in range(16):
        state = run(method, state)
        goal_indices, phase = state.lanes.goal_indices, np.asarray(state.lanes.phase)
        tasks.append(np.asarray(goal_indices.task))
        assert (np.asarray(goal_indices.goal) == goal_indices.task)[phase == TASK].all()
        assert (np.asarray(goal_indices.goal) >= len(env.goal_states))[phase == RETURN].all()
    periods = [tasks[start : start + 4] for start in (3, 7, 11)]
    assert all((np.asarray(period) == period[0]).all() for period in periods), "a task lasts for 100 steps"
    assert len(np.unique([period[0] for period in periods] + tasks[-1:])) > 1
    earned = float(state.lanes.counters.window_reward.sum())
    assert (earned > 400) if algo == "naive" else (8 < earned < 40)


def test_the_step_into_the_absorbing_end_is_rewarded_for_all_later_steps(problem):
    task = make("tabletop_organization", reward_type="dense")
    env = Deployment(budget=1.0, help_above=-1.0, absorbed_reward=-2.0).wrap(task)
    problem = Problem(env, problem.protocol)
    method = tiny_method("naive", discount=[0.9, 0.5])
    state = make_train_state(problem, method, [0, 1])
    first = int(state.replay.row)
    state = advance(problem, method, state, 3, explore=True)
    np.testing.assert_allclose(state.replay.reward[first], [-20.0, -4.0], rtol=1e-5)
    assert np.asarray(unpack(state.replay.flags[first]).absorbed).all()
    listed = np.asarray(state.replay.counts[:, 0] - state.replay.demos[0])
    assert listed.tolist() == [1, 1]
    assert np.asarray(state.lanes.counters.window_reward).tolist() == [-6.0, -6.0]


def test_the_map_counts_every_step(problem):
    method = tiny_method("fbrl")
    state = advance(problem, method, make_train_state(problem, method, [0, 1]), 40, explore=True)
    visits = np.asarray(state.lanes.visits)
    assert visits.sum(axis=(1, 2)).tolist() == [40, 40]
    low, high = problem.env.map_bounds
    position = np.asarray(state.replay.state[int(state.replay.row), :, :2])
    bins = np.floor((position - low) / (high - low) * MAP_BINS).astype(int)
    assert all(visits[lane, x, y] > 0 for lane, (x, y) in enumerate(bins))


def test_a_task_without_a_map_counts_no_visits(problem):
    cheetah = Problem(make("cheetah_run", engine="c"), problem.protocol)
    assert make_train_state(cheetah, tiny_method("naive"), [0, 1]).lanes.visits is None
