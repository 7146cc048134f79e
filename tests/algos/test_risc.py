"""RISC: phases that the method ends, the probability with which it does so, and the critics that it reads."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import struct

from earl_jax.algos import make_algo
from earl_jax.algos.fbrl import FBRL
from earl_jax.algos.learner import replay as replay_lib
from earl_jax.algos.learner import sac
from earl_jax.algos.method import TASK
from earl_jax.training.plan import per_lane
from tests.conftest import make_train_state, run_whole, tiny_method, tiny_train, without_shares

KEYS = jax.random.split(jax.random.key(0), 4000)
OBS = jnp.zeros(12)


class Impatient(FBRL):
    """Leaves every phase after five steps."""

    controllers: int = struct.field(pytree_node=False, default=1)
    name = "impatient"

    def switches(self, key, env, agent, obs, phase, phase_step, method_state):
        return phase_step + 1 >= 5


def agent_of(method, value):
    """Return a fresh agent whose further critics are `value` everywhere, before the division by the reward scale."""
    agent = jax.jit(lambda key: sac.init(key, method.sac, 12, 3, method.critics))(jax.random.key(0))
    critics = jax.tree.map(lambda leaf: leaf.at[sac.SOFT_CRITICS :].set(0.0), agent.critics)
    bias = critics["params"]["hidden_1"]["bias"]
    critics["params"]["hidden_1"]["bias"] = bias.at[sac.SOFT_CRITICS :].set(value)
    return agent.replace(critics=critics)


@functools.partial(jax.jit, static_argnames="env")
def switch_share(method, env, agent, phase_step):
    """Return the share of 4000 keys with which `method` leaves a phase."""
    return jax.vmap(lambda key: method.switches(key, env, agent, OBS, TASK, phase_step, ()))(KEYS).mean()


def test_a_phase_that_the_method_ends_is_stored_as_a_time_out(problem):
    method = per_lane(Impatient(tiny_method("fbrl").sac, fixed_phases=True), 2)
    start = make_train_state(problem, method, [0, 1])
    end = run_whole(problem, method, start, 20, explore=True)
    rows = slice(int(start.replay.row), int(end.replay.row))
    flags = replay_lib.unpack(end.replay.flags[rows])
    step = np.arange(1, 21)
    assert not flags.reached.any()
    np.testing.assert_array_equal(flags.timeout[:, 0], step % 5 == 0)
    is_task = np.asarray(flags.goal[:, 0]) < problem.goals.tasks
    np.testing.assert_array_equal(is_task, (step - 1) // 5 % 2 == TASK)
    assert not flags.no_successor.any()
    assert np.asarray(end.lanes.counters.interventions).tolist() == [0, 0]


def test_risc_never_switches_early_or_in_dense_tasks_or_without_switching(env):
    method = make_algo("risc", hidden_sizes=[16])
    sure = agent_of(method, 10.0)
    assert switch_share(method, env, sure, 98) == 0.0
    assert switch_share(method, env, sure, 99) == 1.0
    assert switch_share(make_algo("risc", hidden_sizes=[16], earliest_switch=0.75), env, sure, 148) == 0.0
    dense = dataclasses.replace(env, reward_type="dense")
    assert method.switches(KEYS[0], dense, sure, OBS, TASK, 150, ()) is False
    plain = make_algo("risc", switching=False)
    assert plain.switches(KEYS[0], env, sure, OBS, TASK, 150, ()) is False
    assert (plain.critics, method.critics) == (2, 4)


@pytest.mark.parametrize(
    ("options", "value", "count", "expected"),
    [
        ({}, 3.0, 150, 0.3),
        ({"switch_share": 0.5}, 10.0, 150, 0.5),
        ({"earliest_switch": 0.0}, 10.0, 2, 1 - 0.9**2),
        ({"earliest_switch": 0.0, "conservative_factor": 0.5}, 8.0, 1, 0.4),
        ({}, 25.0, 150, 1.0),
        ({}, -5.0, 150, 0.0),
        ({"reward_scale": 1.0}, 0.3, 150, 0.3),
    ],
)
def test_the_chance_of_a_switch_is_share_p_and_one_minus_k_to_the_c(env, options, value, count, expected):
    method = make_algo("risc", hidden_sizes=[16], **options)
    share = switch_share(method, env, agent_of(method, value), count - 1)
    assert float(share) == pytest.approx(expected, abs=0.03)


def test_the_success_critics_learn_which_goal_is_reached():
    method = make_algo("risc", hidden_sizes=[16], learning_rate=1e-2)
    agent = jax.jit(lambda key: sac.init(key, method.sac, 2, 1, method.critics))(jax.random.key(0))
    reached = jnp.arange(64) < 32
    obs = jnp.where(reached[:, None], jnp.array([1.0, 0.0]), jnp.array([0.0, 1.0]))
    action = jax.random.uniform(jax.random.key(1), (64, 1), minval=-1.0, maxval=1.0)
    batch = sac.Batch(obs, action, reached.astype(jnp.float32), reached, obs)

    @jax.jit
    def learn_batch(agent):
        update = lambda agent, key: (method.update_agent(key, agent, batch)[0], None)  # noqa: E731
        return jax.lax.scan(update, agent, jax.random.split(jax.random.key(2), 400))[0]

    chance = jax.jit(lambda agent, row: method.success_chance(jax.random.key(3), agent, row, 1))

    def chances(agent):
        return [float(chance(agent, row)) for row in (obs[0], obs[-1])]

    before, after = chances(agent), chances(learn_batch(agent))
    assert after[0] > max(before[0], 0.8)
    assert after[1] < 0.2


def test_risc_trains_by_name_and_fills_one_replay_from_both_phases(env):
    short = dataclasses.replace(env, eval_horizon=20)
    result = tiny_train("risc", short, conservative_factor=0.5, earliest_switch=0.1)
    assert all(np.isfinite(values).all() for values in without_shares(result.metrics).values())
    state = result.train_state
    flags = replay_lib.unpack(state.replay.flags[int(state.replay.first_row) : int(state.replay.row), 0])
    is_task = np.asarray(flags.goal) < 4
    assert is_task.any()
    assert not is_task.all()
    assert int(state.replay.counts[0, 1]) == 0
    moved = result.metrics["critic_loss"][:, -1]
    assert (moved > 0).all()
