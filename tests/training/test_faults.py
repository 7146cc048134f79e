"""A broken simulation is an intervention of one lane: counted, reset, and never learnt from."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.envs import make
from earl_jax.metrics.continuing import continuing
from earl_jax.metrics.deployed import episode
from tests.conftest import advance, assert_all_finite, make_problem, make_train_state, take_lane, tiny_method


@pytest.fixture(scope="module")
def door():
    return make_problem(make("sawyer_door", engine="c"), eval_every=40, eval_episodes=2)


def break_lane(state, lane, fault):
    """Return the train state with a lane whose next step is a `fault`: not a number, or outside the workspace."""
    env_state = state.lanes.env_state
    data = env_state.data
    broken = {
        "nan": data.replace(qvel=data.qvel.at[lane].set(jnp.nan)),
        "outside": data.replace(qpos=data.qpos.at[lane, 9].set(3.0)),
    }
    return state.replace(lanes=state.lanes.replace(env_state=env_state.replace(data=broken[fault])))


@pytest.mark.parametrize("fault", ["nan", "outside"])
def test_a_fault_is_an_intervention_of_its_lane_alone(door, fault):
    method = tiny_method("fbrl", 2)
    state = advance(door, method, make_train_state(door, method, [0, 1]), 20, explore=True)
    unbroken = advance(door, method, state, 10)
    after = advance(door, method, break_lane(state, 1, fault), 10)
    assert np.asarray(after.lanes.counters.faults).tolist() == [0, 1]
    assert np.asarray(after.lanes.counters.interventions).tolist() == [0, 1]
    np.testing.assert_array_equal(after.lanes.env_state.obs[0], unbroken.lanes.env_state.obs[0])
    assert_all_finite((after.replay, after.lanes.agent, after.lanes.counters))
    listed = np.asarray(after.replay.counts - state.replay.counts).sum(axis=1)
    assert listed.tolist() == [10, 9]


def test_the_row_of_a_fault_is_never_sampled(door):
    method = tiny_method("naive", 2)
    state = advance(door, method, make_train_state(door, method, [0, 1]), 20, explore=True)
    row = int(state.replay.row)
    after = advance(door, method, break_lane(state, 1, "nan"), 10)
    index = np.asarray(after.replay.index)
    counts = np.asarray(after.replay.counts)[:, 0]
    assert row in index[: counts[0], 0]
    assert row not in index[: counts[1], 1]
    start = np.asarray(after.replay.state[row + 1, 1])
    np.testing.assert_allclose(start[:3], door.env.initial_states[0, :3], atol=1e-6)


def test_faults_are_reported(door):
    method = tiny_method("naive", 2)
    state = advance(door, method, break_lane(make_train_state(door, method, [0, 1]), 0, "nan"), 20, explore=True)
    lane = take_lane(state.lanes, 0)
    _, metrics = continuing(lane.counters, lane.env_state, jnp.array(20.0), jnp.array(20.0))
    assert int(metrics["faults"]) == 1
    assert np.isfinite(metrics["continuing/reward"])


def test_a_kinematic_task_faults_on_numbers_that_are_not_finite(env):
    state = env.reset(jax.random.key(0))
    assert not bool(env.fault(state))
    after = env.step(state.replace(data=state.data.replace(qpos=state.data.qpos.at[0].set(jnp.inf))), jnp.zeros(3))
    assert bool(env.fault(after.replace(obs=after.obs.at[0].set(jnp.nan))))


def test_an_evaluation_episode_ends_where_the_simulation_breaks(env):
    """The policy's NaN breaks the simulation at once: no success, and a return of the steps before it, not NaN."""
    result = jax.jit(lambda key: episode(env, lambda obs: jnp.full(3, jnp.nan), key, 10))(jax.random.key(0))
    assert float(result["success"]) == 0.0
    assert float(result["return"]) == 0.0
