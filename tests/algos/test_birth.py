"""Lives begin with demonstrations in the replay and a start state after them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax import assets
from earl_jax.algos.learner import replay
from earl_jax.envs import make
from earl_jax.protocol import Protocol
from earl_jax.training import init as birth
from earl_jax.training.state import Problem
from tests.conftest import ALGOS, newborn, tiny_method


@pytest.mark.parametrize(("algo", "reward_type"), [*((algo, "sparse") for algo in ALGOS), ("vaprl", "dense")])
def test_demonstrations_come_first_and_read_back_whole(algo, reward_type):
    env = make("tabletop_organization", reward_type=reward_type)
    problem = Problem(env, Protocol(env.train_horizon, env.eval_horizon))
    method = tiny_method(algo)
    lives = newborn(problem, method, [0, 1])
    rows = replay.sample(lives.replay, jax.random.split(jax.random.key(0), 2), jnp.zeros(2, int), 3000, jnp.zeros(2))
    forward = assets.demos(env.name, "forward")
    known = {
        (s.tobytes(), a.tobytes()): i for i, (s, a) in enumerate(zip(forward.states, forward.actions, strict=True))
    }
    drawn = jax.tree.map(lambda leaf: np.asarray(leaf[0]), rows)
    found = [known.get((s.tobytes(), a.tobytes()), -1) for s, a in zip(drawn.state, drawn.action, strict=True)]
    mine = np.array(found) >= 0
    assert (mine.mean() < 0.9) == (algo == "vaprl")
    which = np.array(found)[mine]
    np.testing.assert_array_equal(drawn.next_state[mine], forward.next_states[which])
    np.testing.assert_array_equal(problem.goals.table[drawn.flags.goal[mine]], forward.goals[which])
    if env.sparse:
        np.testing.assert_array_equal(drawn.reward[mine], forward.rewards[which])
    if not env.sparse:
        assert not rows.flags.reached.any()
        obs = jnp.concatenate([rows.next_state, problem.goals.table[rows.flags.goal]], axis=-1)
        np.testing.assert_allclose(rows.reward, env.reward(obs), rtol=1e-5)


def test_life_starts_after_the_demonstrations_at_rho(problem):
    method = tiny_method("vaprl")
    lives = newborn(problem, method, [0, 1])
    first = int(lives.replay.row)
    assert first == len(problem.goals.candidates)
    np.testing.assert_array_equal(lives.replay.state[first], np.tile(problem.env.initial_states, (2, 1)))
    assert int(lives.step) == 0


def test_vaprl_lists_a_demonstrated_step_for_where_it_leads(problem):
    """The release copies demonstrations for every later state; a copy weighs 1 / (N + 1) of a transition of one's own."""
    rows = birth.demo_rows(problem, tiny_method("vaprl"))
    left = problem.goals.ends[rows.rows] - rows.rows
    np.testing.assert_array_equal(rows.copies, np.maximum(1, np.rint(left / 5)))
    assert birth.capacity_for(problem, tiny_method("vaprl"), 100) == 100 + rows.copies.sum()


def test_different_seeds_differ_and_equal_seeds_agree(problem):
    lives = newborn(problem, tiny_method("naive", 3), [7, 8, 7])
    kernel = jax.tree.leaves(lives.lanes.agent.actor)[1]
    np.testing.assert_array_equal(kernel[0], kernel[2])
    assert np.abs(kernel[0] - kernel[1]).max() > 0.01
