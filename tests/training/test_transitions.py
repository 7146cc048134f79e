"""The transitions of a life, as its replay has them: where attempts end, what is left out, and rewards."""

import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.algos.goals import goal_table
from earl_jax.algos.learner import replay as replay_lib
from earl_jax.algos.learner.replay import TransitionFlags
from earl_jax.envs import HelpBudget, make
from earl_jax.training import transitions
from earl_jax.training.transitions import attempts
from tests.conftest import tiny_train

STEPS = 10
FIRST = 3
"""The first row after the demonstrations."""


def replay_of(env, row=FIRST + STEPS, evicts=False, **at):
    """Return a replay of two lanes, whose second lane has the flags in the steps `at` and states that show their row."""
    flags = {name: np.isin(np.arange(-FIRST, STEPS), at.get(name, ())) for name in TransitionFlags._fields[1:]}
    goals = np.where(np.arange(-FIRST, STEPS) < 5, 0, 1)
    replay = replay_lib.create(FIRST + STEPS, 2, env.state_size, env.action_size, env.sparse, 20 if evicts else None)
    states = np.full(replay.state.shape, np.nan, np.float32)
    states[:, 1] = 10.0 + np.arange(FIRST + STEPS + 1)[:, None]
    if env.has_absorbing_state:
        states[:, 1, -1] = 1 - np.isin(np.arange(FIRST + STEPS + 1) - FIRST - 1, at.get("absorbed", ()))
    return replay.replace(
        state=states,
        action=np.arange(FIRST + STEPS, dtype=np.float32)[:, None, None] * np.ones(replay.action.shape[1:]),
        flags=np.asarray(replay_lib.pack(TransitionFlags(jnp.asarray(goals), **flags)))[:, None] * np.array([0, 1]),
        reward=np.arange(len(replay.reward), dtype=np.float32)[:, None] * np.ones(2, np.float32),
        row=np.int32(row),
        first_row=np.int32(FIRST),
    )


def numbers(states):
    return (states[:, 0] - 10 - FIRST).astype(int).tolist()


def test_an_attempt_ends_at_its_goal_its_time_out_and_a_reset_without_the_step_whose_next_state_is_missing(env):
    replay = replay_of(env, timeout=[2, 7], reached=[4, 5], no_successor=[5, 7])
    steps, terminal = attempts(env, replay, 1, STEPS)
    kept = [0, 1, 2, 3, 4, 5, 6, 8, 9]
    assert numbers(steps.states) == kept
    assert numbers(steps.next_states) == [1, 2, 3, 4, 5, 5, 7, 9, 10], "step 5 reached its goal and was reset"
    assert (steps.actions[:, 0] - FIRST).tolist() == kept
    assert [kept[row] for row in np.flatnonzero(steps.ends)] == [2, 4, 5, 6, 9]
    assert [kept[row] for row in np.flatnonzero(terminal)] == [4, 5]
    assert steps.rewards.tolist() == [0, 0, 0, 0, 0, 1, 0, 0, 0], "recomputed where there is a next state"
    np.testing.assert_array_equal(steps.goals, goal_table(env).table[[0] * 5 + [1] * 4])


def test_the_newest_transitions_of_a_ring_are_in_their_order(env):
    replay = replay_of(env, row=FIRST + 4, evicts=True, timeout=[1])
    steps, _ = attempts(env, replay, 1, 50)
    assert numbers(steps.states) == [5, 6, 7, 8, 9, 0, 1, 2, 3]
    assert numbers(steps.next_states) == [6, 7, 8, 9, 0, 1, 2, 3, 4]
    assert np.flatnonzero(steps.ends).tolist() == [6, 8]


@pytest.mark.parametrize("rewards", ["sparse", "dense"])
def test_a_life_ends_at_its_absorbing_state_with_the_reward_of_one_step(rewards):
    env = HelpBudget(make("tabletop_organization", reward_type=rewards), budget=5.0)
    steps, terminal = attempts(env, replay_of(env, absorbed=[6, 7, 8, 9]), 1, STEPS)
    assert numbers(steps.states) == [0, 1, 2, 3, 4, 5, 6]
    assert (np.flatnonzero(steps.ends).tolist(), np.flatnonzero(terminal).tolist()) == ([6], [6])
    assert steps.rewards.tolist() == ([0] * 7 if rewards == "sparse" else [FIRST + step for step in range(7)])


@pytest.mark.parametrize(
    ("row", "steps", "flags"),
    [(FIRST + 4, 50, {"absorbed": range(STEPS)}), (FIRST + STEPS, STEPS, {"no_successor": range(STEPS)})],
)
def test_no_transition_is_left_after_the_end_of_a_life_or_with_a_reset_at_every_step(row, steps, flags):
    """A ring used to begin with a step from the absorbing state to itself, and no transition used to have an end."""
    env = HelpBudget(make("tabletop_organization"), budget=5.0)
    left, terminal = attempts(env, replay_of(env, row, steps > STEPS, **flags), 1, steps)
    assert {len(field) for field in (*left, terminal)} == {0}


def test_a_run_of_which_no_transition_is_left_says_so(tmp_path, monkeypatch):
    tiny_train("naive", out=tmp_path / "run")
    monkeypatch.setattr(transitions, "attempts", lambda *_: (None, np.zeros(0, bool)))
    with pytest.raises(ValueError, match="run has no transition of seed 1: its life ended before the steps that"):
        transitions.load_transitions(tmp_path / "run", 1)
