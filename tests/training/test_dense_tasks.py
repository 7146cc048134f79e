"""Training on dense rewards: one task and method, and with the slow tests the other tasks and methods."""

import itertools

import jax
import numpy as np
import pytest

from earl_jax.algos.method import RETURN
from earl_jax.envs import make
from earl_jax.training import train
from earl_jax.training.scan import run_steps
from tests.conftest import assert_all_finite, make_problem, make_train_state, tiny_method

PAIRS = [
    ("minitaur_pen", "fbrl"),
    *(
        pytest.param(*pair, marks=pytest.mark.slow)
        for pair in (
            ("dhand_lightbulb", "fbrl"),
            ("franka_kitchen", "fbrl"),
            ("franka_kitchen", "oracle"),
            ("minitaur_pen", "naive"),
            ("minitaur_pen", "r3l"),
        )
    ),
]
"""A return to the start is the only phase whose reward the task computes; the other methods learn from the stored one."""
EVAL_HORIZON = 6


def train_states(problem, method, steps):
    """Return the train states before the first and after every one of `steps` steps."""
    step = jax.jit(lambda m, state: run_steps(problem, m, state, 1))
    states = [make_train_state(problem, method, [0, 1], steps)]
    for _ in range(steps):
        states.append(step(method, states[-1]))
    return states


def return_rewards(problem, states):
    """Return the stored rewards of return phases, and the rewards that their goals, initial states all, would give."""
    goal_reward = jax.jit(jax.vmap(problem.env.goal_reward))
    stored, expected = [], []
    for before, after in itertools.pairwise(states):
        goal = before.lanes.env_state.info["goal"]
        returning = (np.asarray(before.lanes.phase) == RETURN) & (np.asarray(after.lanes.phase_step) > 0)
        for lane in np.flatnonzero(returning):
            assert (np.abs(problem.env.initial_states - goal[lane]).max(axis=1) < 1e-6).any()
        stored += np.asarray(after.replay.reward[int(before.replay.row)])[returning].tolist()
        expected += np.asarray(goal_reward(after.lanes.env_state, goal))[returning].tolist()
    return stored, expected


@pytest.mark.parametrize(("task", "algo"), PAIRS)
def test_methods_train_on_dense_rewards(task, algo):
    problem = make_problem(make(task, engine="c", eval_horizon=EVAL_HORIZON), eval_every=40, eval_episodes=2)
    states = train_states(problem, tiny_method(algo, 2), 24)
    last = states[-1]
    assert_all_finite((last.replay, last.lanes.agent, last.lanes.counters))
    assert np.asarray(last.lanes.counters.faults).tolist() == [0, 0]
    assert np.asarray(last.lanes.counters.reached).tolist() == [0, 0], "a dense reward ends no phase"
    assert np.asarray(last.lanes.counters.interventions).tolist() == [4 * (algo == "oracle")] * 2
    assert np.unique(np.asarray(last.replay.reward[:24])).size > 40, "every transition keeps its own reward"
    if algo == "fbrl":
        stored, expected = return_rewards(problem, states)
        assert len(stored) >= 20
        np.testing.assert_allclose(stored, expected, rtol=1e-4, atol=1e-5)


def test_vaprl_without_demonstrations_is_refused_and_nothing_is_written(tmp_path):
    with pytest.raises(ValueError, match="vaprl needs demonstrations, and minitaur_pen has none"):
        train("minitaur_pen", "vaprl", steps=100, out=tmp_path / "run")
    assert not (tmp_path / "run").exists()
