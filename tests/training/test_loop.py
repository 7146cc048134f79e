"""The training step: pure, deterministic, independent of the number of lanes, with correct phases and resets."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.algos import SAC, Method, make_algo
from earl_jax.algos.learner.replay import unpack
from earl_jax.algos.method import RETURN
from earl_jax.envs import make
from earl_jax.physics.engines import c
from earl_jax.protocol import Protocol
from earl_jax.training import loop, runner, scan
from earl_jax.training.plan import per_lane
from earl_jax.training.state import Problem
from tests.conftest import (
    ALGOS,
    CHUNK,
    advance,
    assert_all_finite,
    assert_equal_trees,
    make_problem,
    make_train_state,
    run_whole,
    take_lane,
    tiny_method,
)

EVERY_ALGO = pytest.mark.parametrize("algo", ALGOS)


@EVERY_ALGO
def test_chunks_equal_one_scan_bit_for_bit_and_keep_structure_dtypes_and_weak_types(problem, algo):
    method = tiny_method(algo)
    start = make_train_state(problem, method, [0, 1])
    types = [jax.typeof(leaf) for leaf in jax.tree.leaves(start)]
    whole = run_whole(problem, method, start, 60)
    chunked = advance(problem, method, start, 60)
    assert_all_finite(chunked.lanes.agent)
    assert_equal_trees(chunked, whole)
    assert int(whole.step) == 60
    assert [jax.typeof(leaf) for leaf in jax.tree.leaves(whole)] == types


@pytest.mark.parametrize("algo", ["fbrl", "vaprl"])
def test_a_seed_trains_the_same_alone_and_beside_others(problem, algo):
    beside = advance(problem, tiny_method(algo, 2), make_train_state(problem, tiny_method(algo, 2), [4, 5]), 40)
    alone = advance(problem, tiny_method(algo, 1), make_train_state(problem, tiny_method(algo, 1), [5]), 40)
    last = take_lane(beside.lanes, slice(1, 2))
    assert_equal_trees(last.env_state, alone.lanes.env_state, rtol=1e-4, atol=1e-4)
    assert_equal_trees(last.goal_indices, alone.lanes.goal_indices)
    np.testing.assert_allclose(beside.replay.action[:, 1], alone.replay.action[:, 0], atol=1e-4)
    np.testing.assert_array_equal(beside.replay.index[:, 1], alone.replay.index[:, 0])


def test_the_program_is_traced_once(problem):
    method = tiny_method("naive")
    state = advance(problem, method, make_train_state(problem, method, [0, 1]), CHUNK)
    programs = runner._advance._cache_size()
    assert programs > 0
    for _ in range(2):
        state = advance(problem, method, state, CHUNK)
    assert runner._advance._cache_size() == programs


def test_lanes_may_differ_in_their_hyper_parameters(problem):
    mixed = tiny_method("naive", 2, learning_rate=[3e-4, 1e-2])
    state = advance(problem, mixed, make_train_state(problem, mixed, [0, 0]), 40)
    same = tiny_method("naive", 2, learning_rate=[3e-4, 3e-4])
    twins = advance(problem, same, make_train_state(problem, same, [0, 0]), 40)
    kernel = jax.tree.leaves(state.lanes.agent.critics)[1]
    twin = jax.tree.leaves(twins.lanes.agent.critics)[1]
    np.testing.assert_array_equal(twin[0], twin[1])
    np.testing.assert_allclose(kernel[0], twin[0], atol=1e-5)
    assert np.abs(kernel[1] - twin[1]).max() > 1e-3


@pytest.fixture
def expert_acts(monkeypatch):
    """Let the scripted expert act in place of every learnt controller."""

    def act(problem, method, lane, key, explore):
        return problem.env.expert(lane.env_state.obs)

    monkeypatch.setattr(loop, "_act", act)


def explore(problem, method, steps, lanes=4):
    """Return the lanes of a fresh training after `steps` steps without updates."""
    state = make_train_state(problem, method, range(lanes), steps)
    return run_whole(problem, method, state, steps, explore=True)


@pytest.mark.parametrize(("algo", "published"), [("naive", 26.6), ("oracle", 41.0), ("fbrl", 82.5), ("vaprl", 82.5)])
def test_experts_in_the_loop_earn_at_the_published_rate(problem, expert_acts, algo, published):
    """Scripted optima that the converged reward rates of the paper's runs imply, in env steps per +1 of task reward."""
    options = {"epsilon": -1.0} if algo == "vaprl" else {}
    counters = explore(problem, tiny_method(algo, 4, **options), 8000).lanes.counters
    rate = 8000 * 4 / float(counters.window_reward.sum())
    assert rate == pytest.approx(published, rel=0.05)
    assert int(counters.reached.sum()) == int(counters.window_reward.sum())
    interventions = np.asarray(counters.interventions)
    assert (interventions == counters.reached).all() if algo == "oracle" else not interventions.any()


def test_r3l_alternates_success_with_a_full_perturbation(problem, monkeypatch):
    """41 steps forward, then 200 that success never ends, as in the published 240 steps a reward."""

    def act(problem, method, lane, key, explore):
        home = problem.env.with_goal(lane.env_state, jnp.asarray(problem.env.initial_states[0])).obs
        return problem.env.expert(jnp.where(lane.phase == RETURN, home, lane.env_state.obs))

    monkeypatch.setattr(loop, "_act", act)
    counters = explore(problem, tiny_method("r3l", 4), 9600).lanes.counters
    rate = 9600 * 4 / float(counters.reached.sum())
    assert rate == pytest.approx(240, rel=0.03)


def stored_flags(state, steps):
    """Return the flags [steps, N] of the last `steps` transitions."""
    first = int(state.replay.row) - steps
    return jax.tree.map(np.asarray, unpack(state.replay.flags[first : first + steps]))


@pytest.mark.parametrize(("algo", "length"), [("naive", 1000), ("fbrl", 200), ("r3l", 200), ("vaprl", 200)])
def test_an_unreached_goal_times_out_after_the_published_steps(problem, monkeypatch, algo, length):
    monkeypatch.setattr(loop, "_act", lambda *_: jnp.zeros(3))
    flags = stored_flags(explore(problem, tiny_method(algo, 1), 2 * length, lanes=1), 2 * length)
    assert np.flatnonzero(flags.timeout[:, 0])[0] == length - 1
    assert not flags.reached[: length - 1].any()


def test_a_hard_intervention_every_train_horizon_steps_resets_the_lane(env):
    problem = Problem(env, Protocol(train_horizon=50, eval_horizon=200))
    state = explore(problem, tiny_method("fbrl", 2), 150, lanes=2)
    flags = stored_flags(state, 150)
    for lane in range(2):
        assert set(np.flatnonzero(flags.no_successor[:, lane])) == {49, 99, 149}
        assert flags.timeout[[49, 99, 149], lane].all()
    np.testing.assert_array_equal(state.lanes.counters.interventions, [3, 3])
    np.testing.assert_array_equal(state.lanes.env_state.obs[:, :6], np.tile(env.initial_states, (2, 1)))
    np.testing.assert_array_equal(state.lanes.phase, [0, 0])


def test_a_bootstrapped_timeout_without_successor_is_not_listed(env):
    problem = Problem(env, Protocol(train_horizon=50, eval_horizon=200))
    counts = {}
    for bootstrap in (False, True):
        method = tiny_method("naive", 1, timeout_bootstrap=bootstrap)
        counts[bootstrap] = int(explore(problem, method, 150, lanes=1).replay.counts[0, 0])
    assert counts[False] - counts[True] == 3


def test_a_refresh_runs_at_the_start_of_every_block(problem):
    method = tiny_method("vaprl")
    start = make_train_state(problem, method, [0, 1])
    assert not start.lanes.method_state.values.any()
    expected = jax.jit(lambda m, s: scan.refresh(problem, m, s))(method, start).lanes.method_state.values
    np.testing.assert_allclose(advance(problem, method, start, 20).lanes.method_state.values, expected, atol=1e-5)
    assert np.abs(advance(problem, method, start, 40).lanes.method_state.values - expected).max() > 1e-4


def test_vaprl_without_demonstrations_is_an_error(problem, monkeypatch):
    monkeypatch.setattr("earl_jax.assets.has_demos", lambda name: False)
    with pytest.raises(ValueError, match="vaprl needs demonstrations"):
        make_train_state(problem, make_algo("vaprl"), [0])


class LatestRow(Method):
    """Remembers the latest row of the batch that it learnt from."""

    name = "latest_row"
    demo_directions = ()

    def init_state(self, key, env, goals):
        return jnp.zeros((), jnp.int32)

    def update_state(self, key, env, goals, batch, phase, method_state):
        return batch.row.max()


def test_a_batch_holds_transitions_stored_before_its_step():
    problem = make_problem(make("cheetah_run", engine="c"))
    method = per_lane(LatestRow(SAC(hidden_sizes=(8,), batch_size=64)), 2)
    state = advance(problem, method, make_train_state(problem, method, [0, 1]), 3, explore=True)
    for step in (3, 4, 5):
        state = advance(problem, method, state, 1)
        np.testing.assert_array_equal(state.lanes.method_state, [step - 1] * 2)


def test_a_step_started_on_the_host_and_finished_later_equals_a_whole_step(monkeypatch):
    problem = make_problem(make("sawyer_door", engine="c"))
    method = tiny_method("naive", demo_share=0.5)
    start = make_train_state(problem, method, [0, 1], steps=60)
    whole = run_whole(problem, method, start, 20)
    monkeypatch.setattr(c, "_host_runs_beside_device", lambda: True)
    halves = run_whole(problem, method, start, 20)
    assert_equal_trees(halves, whole)
    assert int(whole.step) == 20
