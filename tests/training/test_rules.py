"""Rules in training: interventions, faults, the absorbing end, lanes that diverge, and the map of visits."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.envs import make
from earl_jax.envs.tabletop import TabletopOrganization
from earl_jax.protocol import Deployment
from earl_jax.training import runner
from earl_jax.training.state import MAP_BINS, Problem, step_keys
from tests.conftest import (
    CHUNK,
    advance,
    assert_all_finite,
    evaluate,
    lane_rules,
    make_problem,
    make_train_state,
    stored_flags,
    tiny_method,
    tiny_train,
)


def test_lanes_of_one_program_follow_their_own_rules(env, problem):
    rules = lane_rules([0, 40], [0.1, 0.0], [0, 0])
    start = make_train_state(problem, tiny_method("fbrl"), [0, 1], rules=rules)
    state = advance(problem, tiny_method("fbrl"), start, 120, warmup=True)
    by_chance, by_horizon = np.asarray(state.lanes.counters.interventions)
    assert by_horizon == 3
    assert 4 <= by_chance <= 24
    flags = stored_flags(state, 120)
    assert np.flatnonzero(flags.no_successor[:, 1]).tolist() == [39, 79, 119]
    assert flags.no_successor[:, 0].sum() == by_chance
    assert flags.timeout[flags.no_successor].all()
    np.testing.assert_array_equal(state.lanes.env_state.obs[1, :6], env.initial_states[0])
    assert int(state.lanes.phase[1]) == 0


def test_interventions_by_chance_do_not_choose_the_start_that_follows():
    """Their key used to be the second one into which a reset splits its own, with which fish_swim turns the fish."""

    @jax.jit
    @jax.vmap
    def draws(step):
        keys = step_keys(jax.random.key(0), step)
        return [jax.random.uniform(key) for key in (keys.chance, jax.random.split(keys.reset)[1])]

    chance, start = map(np.asarray, draws(jnp.arange(4000)))
    assert start[chance < 0.1].mean() == pytest.approx(0.5, abs=0.06)


def test_a_later_run_with_other_rules_compiles_nothing():
    programs = runner._init, runner._advance, runner._evaluate
    first = tiny_train("naive")
    compiled = [program._cache_size() for program in programs]
    later = tiny_train("naive", setting="continuing", goal_change=7, intervention_chance=0.2)
    assert [program._cache_size() for program in programs] == compiled
    interventions = [result.metrics["interventions"][:, -1] for result in (first, later)]
    assert (interventions[1] > interventions[0]).all()


def test_a_bootstrapped_timeout_without_successor_is_not_listed(problem):
    method = tiny_method("naive")
    method = method.replace(learner=method.learner.replace(timeout_bootstrap=jnp.array([False, True])))
    start = make_train_state(problem, method, [0, 1], rules=lane_rules([40, 40], [0.0, 0.0], [0, 0]))
    counts = advance(problem, method, start, 120, warmup=True).replay.counts[:, 0]
    assert counts[0] - counts[1] == 3


def test_the_step_into_the_absorbing_end_is_stored_with_its_reward(problem):
    task = make("tabletop_organization", reward_type="dense")
    env = Deployment(budget=1.0, help_above=-1.0, absorbed_reward=-2.0).wrap(task)
    method = tiny_method("naive")
    state = make_train_state(Problem(env, problem.protocol), method, [0, 1])
    first = int(state.replay.row)
    state = advance(Problem(env, problem.protocol), method, state, 3, warmup=True)
    assert np.asarray(state.replay.reward[first]).tolist() == [-2.0, -2.0]
    assert stored_flags(state, 3).absorbed[0].all()
    listed = np.asarray(state.replay.counts[:, 0] - state.replay.demos[0])
    assert listed.tolist() == [1, 1]
    assert np.asarray(state.lanes.counters.window_reward).tolist() == [-6.0, -6.0]
    assert state.lanes.visits.sum(axis=(1, 2)).tolist() == [1, 1]


def test_the_map_counts_every_step_with_a_position(problem):
    """A step to NaN used to count in a corner."""
    method = tiny_method("fbrl")
    state = advance(problem, method, make_train_state(problem, method, [0, 1]), 40, warmup=True)
    visits = np.asarray(state.lanes.visits)
    assert visits.sum(axis=(1, 2)).tolist() == [40, 40]
    low, high = problem.env.map.bounds
    position = np.asarray(state.replay.state[int(state.replay.row), :, :2])
    bins = np.floor((position - low) / (high - low) * MAP_BINS).astype(int)
    assert all(visits[lane, x, y] > 0 for lane, (x, y) in enumerate(bins))
    env_state = state.lanes.env_state
    data = env_state.data.replace(qpos=env_state.data.qpos.at[1].set(jnp.nan))
    broken = state.replace(lanes=state.lanes.replace(env_state=env_state.replace(data=data)))
    after = advance(problem, method, broken, 1, warmup=True)
    assert after.lanes.visits.sum(axis=(1, 2)).tolist() == [41, 40]


@pytest.mark.parametrize(("field", "value"), [("qvel", np.nan), ("qpos", 3.0)], ids=["nan", "outside"])
def test_a_fault_is_an_intervention_of_its_lane_alone_and_never_learnt_from(door, field, value):
    method = tiny_method("fbrl", 2)
    state = advance(door, method, make_train_state(door, method, [0, 1]), CHUNK, warmup=True)
    unbroken = advance(door, method, state, CHUNK)
    env_state = state.lanes.env_state
    data = env_state.data.replace(**{field: getattr(env_state.data, field).at[1, 9].set(value)})
    broken = state.replace(lanes=state.lanes.replace(env_state=env_state.replace(data=data)))
    after = advance(door, method, broken, CHUNK)
    assert np.asarray(after.lanes.counters.faults).tolist() == [0, 1]
    assert np.asarray(after.lanes.counters.interventions).tolist() == [0, 1]
    np.testing.assert_array_equal(after.lanes.env_state.obs[0], unbroken.lanes.env_state.obs[0])
    assert_all_finite((after.replay, after.lanes.agent, after.lanes.counters))
    listed = np.asarray(after.replay.counts - state.replay.counts).sum(axis=1)
    assert listed.tolist() == [CHUNK, CHUNK - 1]
    row, index, counts = int(state.replay.row), np.asarray(after.replay.index), np.asarray(after.replay.counts)
    assert row in index[: counts[0, 0], 0]
    assert row not in index[: counts[1, 0], 1]
    restart = np.asarray(after.replay.state[row + 1, 1])
    np.testing.assert_allclose(restart[:3], door.env.initial_states[0, :3], atol=1e-6)


def test_a_reward_that_is_not_finite_is_a_fault_of_its_lane():
    class BrokenReward(TabletopOrganization):
        name = "broken_reward"

        @property
        def demonstrations(self):
            """None; those of the table have such rewards."""
            return dataclasses.replace(super().demonstrations, task=self.name)

        def reward(self, obs):
            """Return a reward that is not finite in the right half of the table."""
            return jnp.where(obs[..., 0] > 0, jnp.nan, -jnp.abs(obs[..., 0]))

    problem = make_problem(BrokenReward(reward_type="dense"), eval_every=40, eval_episodes=2)
    method = tiny_method("naive")
    state = advance(problem, method, make_train_state(problem, method, [0, 1]), CHUNK, warmup=True)
    assert (np.asarray(state.lanes.counters.faults) > 0).all()
    assert np.isfinite(state.lanes.counters.window_reward).all()
    assert np.isfinite(state.replay.reward).all()


def test_a_lane_that_diverges_is_marked_and_changes_no_other(problem):
    """A temperature that is not finite spoils the losses of its lane, then its networks and actions."""
    method = tiny_method("naive")
    state = advance(problem, method, make_train_state(problem, method, [0, 1]), CHUNK, warmup=True)
    agent = state.lanes.agent
    agent = agent.replace(log_temperature=agent.log_temperature.at[1].set(jnp.inf))
    broken = state.replace(lanes=state.lanes.replace(agent=agent))
    sound, diverged = (evaluate(problem, method, advance(problem, method, own, CHUNK))[1] for own in (state, broken))
    assert sound["diverged"].tolist() == [0, 0]
    assert diverged["diverged"].tolist() == [0, 1]
    for name, values in sound.items():
        np.testing.assert_array_equal(diverged[name][0], values[0], err_msg=name)
    assert np.isfinite(sound["critic_loss"]).all()
    assert int(diverged["faults"][0]) == 0
    assert int(diverged["faults"][1]) > CHUNK / 2
