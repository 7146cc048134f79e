"""A simulation that breaks is one lane's intervention: counted, put back, and nothing of it is learnt from."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.envs import make
from earl_jax.metrics.continuing import continuing_lane
from earl_jax.metrics.deployed import episode
from earl_jax.protocol import Protocol
from earl_jax.training.state import Problem
from tests.conftest import advance, newborn, tiny_method


@pytest.fixture(scope="module")
def door():
    env = make("sawyer_door", physics="c")
    return Problem(env, Protocol(env.train_horizon, env.eval_horizon, eval_every=40, eval_episodes=2))


def broken(lives, lane, how):
    data = lives.lanes.world.data
    poison = {
        "nan": data.replace(qvel=data.qvel.at[lane].set(jnp.nan)),
        "outside": data.replace(qpos=data.qpos.at[lane, 9].set(3.0)),
    }
    return lives.replace(lanes=lives.lanes.replace(world=lives.lanes.world.replace(data=poison[how])))


@pytest.mark.parametrize("how", ["nan", "outside"])
def test_a_fault_is_an_intervention_of_its_lane_alone(door, how):
    method = tiny_method("fbrl", 2)
    lives = advance(door, method, newborn(door, method, [0, 1]), 20, explore=True)
    whole = advance(door, method, lives, 10)
    after = advance(door, method, broken(lives, 1, how), 10)
    assert np.asarray(after.lanes.counters.faults).tolist() == [0, 1]
    assert np.asarray(after.lanes.counters.interventions).tolist() == [0, 1]
    np.testing.assert_array_equal(after.lanes.world.obs[0], whole.lanes.world.obs[0])
    assert all(
        np.isfinite(leaf).all() for leaf in jax.tree.leaves((after.replay, after.lanes.agent, after.lanes.counters))
    )
    before, now = np.asarray(lives.replay.counts), np.asarray(after.replay.counts)
    assert (now - before).sum(axis=1).tolist() == [10, 9]


def test_the_row_of_a_fault_is_never_sampled(door):
    method = tiny_method("naive", 2)
    lives = advance(door, method, newborn(door, method, [0, 1]), 20, explore=True)
    row = int(lives.replay.row)
    after = advance(door, method, broken(lives, 1, "nan"), 10)
    listed = np.asarray(after.replay.index)
    counts = np.asarray(after.replay.counts)[:, 0]
    assert row in listed[: counts[0], 0]
    assert row not in listed[: counts[1], 1]
    start = np.asarray(after.replay.state[row + 1, 1])
    np.testing.assert_allclose(start[:3], door.env.initial_states[0, :3], atol=1e-6)


def test_faults_are_reported(door):
    method = tiny_method("naive", 2)
    lives = advance(door, method, broken(newborn(door, method, [0, 1]), 0, "nan"), 5, explore=True)
    lane = jax.tree.map(lambda leaf: leaf[0], lives.lanes)
    _, metrics = continuing_lane(lane, jnp.array(5.0), jnp.array(5.0))
    assert int(metrics["faults"]) == 1
    assert np.isfinite(metrics["continuing/reward"])


def test_a_kinematic_world_faults_on_numbers_that_are_not_finite(env):
    state = env.reset(jax.random.key(0))
    assert not bool(env.fault(state))
    after = env.step(state.replace(data=state.data.replace(qpos=state.data.qpos.at[0].set(jnp.inf))), jnp.zeros(3))
    assert bool(env.fault(after.replace(obs=after.obs.at[0].set(jnp.nan))))


def test_an_evaluation_episode_ends_where_the_simulation_breaks(env):
    """The policy's NaN breaks the world at once: no success and a return of what came before it, not NaN."""
    result = jax.jit(lambda key: episode(env, lambda obs: jnp.full(3, jnp.nan), key, 10))(jax.random.key(0))
    assert float(result["success"]) == 0.0
    assert float(result["return"]) == 0.0
