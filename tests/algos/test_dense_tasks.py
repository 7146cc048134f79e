"""The three tasks with dense rewards under every method that applies to them."""

import itertools

import jax
import numpy as np
import pytest

from earl_jax.algos.method import RETURN
from earl_jax.envs import make
from earl_jax.protocol import Protocol
from earl_jax.training import loop as autonomy
from earl_jax.training import train
from earl_jax.training.state import Problem
from tests.conftest import newborn, tiny_method

TASKS = ("dhand_lightbulb", "franka_kitchen", "minitaur_pen")
PAIRS = [(task, algo) for task in TASKS for algo in ("fbrl", "r3l")] + [
    ("minitaur_pen", "naive"),
    ("franka_kitchen", "oracle"),
]


def loop_of(task, horizon=6):
    env = make(task, physics="c", eval_horizon=horizon)
    return Problem(env, Protocol(env.train_horizon, env.eval_horizon, eval_every=40, eval_episodes=2))


def lived(problem, method, steps):
    """Return the lives after every one of `steps` steps."""
    step = jax.jit(lambda m, state: autonomy.run(problem, m, state, 1))
    lives = [newborn(problem, method, [0, 1], steps)]
    for _ in range(steps):
        lives.append(step(method, lives[-1]))
    return lives


def returning_rewards(problem, lives):
    """Return the stored rewards of steps of the second phase and what its goals, initial states all, would pay."""
    stored, due = [], []
    for before, after in itertools.pairwise(lives):
        goal = before.lanes.world.info["goal"]
        now = (np.asarray(before.lanes.phase) == RETURN) & (np.asarray(after.lanes.phase_step) > 0)
        for lane in np.flatnonzero(now):
            assert (np.abs(problem.env.initial_states - goal[lane]).max(axis=1) < 1e-6).any()
        stored += np.asarray(after.replay.reward[int(before.replay.row)])[now].tolist()
        due += np.asarray(jax.vmap(problem.env.goal_reward)(after.lanes.world, goal))[now].tolist()
    return stored, due


@pytest.mark.parametrize(("task", "algo"), PAIRS)
def test_methods_live_in_them(task, algo):
    problem, method = loop_of(task), tiny_method(algo, 2)
    lives = lived(problem, method, 24)
    last = lives[-1]
    assert all(
        np.isfinite(leaf).all() for leaf in jax.tree.leaves((last.replay, last.lanes.agent, last.lanes.counters))
    )
    assert np.asarray(last.lanes.counters.faults).tolist() == [0, 0]
    assert np.asarray(last.lanes.counters.reached).tolist() == [0, 0], "a dense reward ends no phase"
    assert np.asarray(last.lanes.counters.interventions).tolist() == [4 * (algo == "oracle")] * 2
    assert np.unique(np.asarray(last.replay.reward[:24])).size > 40, "every transition keeps the reward it was given"
    if algo == "fbrl":
        stored, due = returning_rewards(problem, lives)
        assert len(stored) >= 20
        np.testing.assert_allclose(stored, due, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("task", TASKS)
def test_without_demonstrations_there_is_no_vaprl_and_nothing_is_written(task, tmp_path):
    with pytest.raises(ValueError, match=f"vaprl needs demonstrations, and {task} has none"):
        train(task, "vaprl", steps=100, out=tmp_path / "run")
    assert not (tmp_path / "run").exists()
