"""The one loop: pure, deterministic, blind to how many lanes run beside one, and right about phases and resets."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.algos import SAC, Method, make_algo
from earl_jax.envs import make
from earl_jax.physics.engines import c
from earl_jax.protocol import Protocol
from earl_jax.training import loop as autonomy
from earl_jax.training import per_lane
from earl_jax.training.state import Problem
from tests.conftest import ALGOS, advance, assert_same, newborn, tiny_method

EVERY = pytest.mark.parametrize("algo", ALGOS)


@EVERY
def test_scan_keeps_structure_dtypes_and_weak_types(problem, algo):
    method = tiny_method(algo)
    lives = newborn(problem, method, [0, 1])
    before = jax.tree.map(jax.typeof, lives)
    after = jax.eval_shape(lambda m, state: autonomy.train_step(problem, m, state), method, lives)
    ones, others = jax.tree.leaves(before), jax.tree.leaves(after)
    assert [(a.shape, a.dtype, a.weak_type) for a in ones] == [(b.shape, b.dtype, b.weak_type) for b in others]


@EVERY
def test_chunks_equal_one_scan_bit_for_bit(problem, algo):
    method = tiny_method(algo)
    start = newborn(problem, method, [0, 1])
    whole = advance(problem, method, start, 60)
    parts = start
    for _ in range(3):
        parts = advance(problem, method, parts, 20)
    assert_same(whole, parts)
    assert int(whole.step) == 60


@pytest.mark.parametrize("algo", ["fbrl", "vaprl"])
def test_a_seed_lives_the_same_life_alone_and_in_company(problem, algo):
    together = advance(problem, tiny_method(algo, 3), newborn(problem, tiny_method(algo, 3), [4, 5, 6]), 40)
    alone = advance(problem, tiny_method(algo, 1), newborn(problem, tiny_method(algo, 1), [5]), 40)
    middle = jax.tree.map(lambda leaf: leaf[1:2], together.lanes)
    assert_same(middle.world, alone.lanes.world, rtol=1e-4, atol=1e-4)
    assert_same(middle.commands, alone.lanes.commands)
    np.testing.assert_allclose(together.replay.action[:, 1], alone.replay.action[:, 0], atol=1e-4)
    np.testing.assert_array_equal(together.replay.index[:, 1], alone.replay.index[:, 0])


def test_the_program_compiles_once(problem):
    method, traces = tiny_method("naive"), []
    lives = newborn(problem, method, [0, 1])

    @jax.jit
    def run(m, state):
        traces.append(1)
        return autonomy.run(problem, m, state, 20)

    for _ in range(3):
        lives = run(method, lives)
    assert len(traces) == 1


def test_lanes_may_differ_in_their_hyper_parameters(problem):
    mixed = tiny_method("naive", 2, learning_rate=[3e-4, 1e-2])
    lives = advance(problem, mixed, newborn(problem, mixed, [0, 0]), 40)
    same = tiny_method("naive", 2, learning_rate=[3e-4, 3e-4])
    twins = advance(problem, same, newborn(problem, same, [0, 0]), 40)
    kernel = jax.tree.leaves(lives.lanes.agent.critics)[1]
    twin = jax.tree.leaves(twins.lanes.agent.critics)[1]
    np.testing.assert_array_equal(twin[0], twin[1])
    np.testing.assert_allclose(kernel[0], twin[0], atol=1e-5)
    assert np.abs(kernel[1] - twin[1]).max() > 1e-3


@pytest.fixture
def scripted(monkeypatch):
    """Let the scripted expert act in the place of every learnt controller."""

    def act(problem, method, lane, key, explore):
        return problem.env.expert(lane.world.obs)

    monkeypatch.setattr(autonomy, "_act", act)


def lived(problem, method, steps, lanes=4):
    lives = newborn(problem, method, range(lanes), steps)
    return advance(problem, method, lives, steps, explore=True)


@pytest.mark.parametrize(("algo", "published"), [("naive", 26.6), ("oracle", 41.0), ("fbrl", 82.5), ("vaprl", 82.5)])
def test_experts_in_the_loop_earn_at_the_published_cycle(problem, scripted, algo, published):
    """Scripted optima that the converged reward rates of the paper's runs imply, in env steps per +1 of task reward."""
    options = {"epsilon": -1.0} if algo == "vaprl" else {}
    counters = lived(problem, tiny_method(algo, 4, **options), 8000).lanes.counters
    rate = 8000 * 4 / float(counters.window_reward.sum())
    assert rate == pytest.approx(published, rel=0.05)
    assert int(counters.reached.sum()) == int(counters.window_reward.sum())
    interventions = np.asarray(counters.interventions)
    assert (interventions == counters.reached).all() if algo == "oracle" else not interventions.any()


def test_r3l_alternates_success_with_a_full_perturbation(problem, scripted, monkeypatch):
    """41 steps forward, then 200 that success never ends, as in the published 240 steps a reward."""

    def away(problem, method, lane, key, explore):
        home = problem.env.with_goal(lane.world, jnp.asarray(problem.env.initial_states[0])).obs
        return problem.env.expert(jnp.where(lane.phase == 1, home, lane.world.obs))

    monkeypatch.setattr(autonomy, "_act", away)
    counters = lived(problem, tiny_method("r3l", 4), 9600).lanes.counters
    rate = 9600 * 4 / float(counters.reached.sum())
    assert rate == pytest.approx(240, rel=0.03)


@pytest.mark.parametrize(("algo", "length"), [("naive", 1000), ("fbrl", 200), ("r3l", 200), ("vaprl", 200)])
def test_an_unreached_goal_times_out_after_the_published_steps(problem, monkeypatch, algo, length):
    monkeypatch.setattr(autonomy, "_act", lambda *_: jnp.zeros(3))
    lives = lived(problem, tiny_method(algo, 1), 2 * length, lanes=1)
    first = int(lives.replay.row) - 2 * length
    flags = jax.tree.map(np.asarray, autonomy.replay_lib.unpack(lives.replay.flags[first:, 0]))
    ends = np.flatnonzero(flags.timeout)
    assert ends[0] == length - 1
    assert not flags.reached[: length - 1].any()


def test_hard_interventions_come_every_h_t_and_start_anew(env):
    problem = Problem(env, Protocol(train_horizon=50, eval_horizon=200))
    lives = lived(problem, tiny_method("fbrl", 2), 150, lanes=2)
    first = int(lives.replay.row) - 150
    flags = jax.tree.map(np.asarray, autonomy.replay_lib.unpack(lives.replay.flags[first:]))
    for lane in range(2):
        assert set(np.flatnonzero(flags.no_successor[:, lane])) == {49, 99, 149}
        assert flags.timeout[[49, 99, 149], lane].all()
    np.testing.assert_array_equal(lives.lanes.counters.interventions, [3, 3])
    np.testing.assert_array_equal(lives.lanes.world.obs[:, :6], np.tile(env.initial_states, (2, 1)))
    np.testing.assert_array_equal(lives.lanes.phase, [0, 0])


def test_a_bootstrapped_time_out_without_successor_is_not_listed(env):
    problem = Problem(env, Protocol(train_horizon=50, eval_horizon=200))
    counts = {}
    for bootstrap in (False, True):
        method = tiny_method("naive", 1, timeout_bootstrap=bootstrap)
        counts[bootstrap] = int(lived(problem, method, 150, lanes=1).replay.counts[0, 0])
    assert counts[False] - counts[True] == 3


def test_a_refresh_runs_at_the_start_of_every_block(problem):
    method = tiny_method("vaprl")
    start = newborn(problem, method, [0, 1])
    assert not start.lanes.method_state.values.any()
    by_hand = autonomy.refresh(problem, method, start).lanes.method_state.values
    np.testing.assert_allclose(advance(problem, method, start, 20).lanes.method_state.values, by_hand, atol=1e-5)
    assert np.abs(advance(problem, method, start, 40).lanes.method_state.values - by_hand).max() > 1e-4


def test_vaprl_without_demonstrations_says_so(problem, monkeypatch):
    monkeypatch.setattr("earl_jax.assets.has_demos", lambda name: False)
    with pytest.raises(ValueError, match="vaprl needs demonstrations"):
        newborn(problem, make_algo("vaprl"), [0])


class Witness(Method):
    """Remembers the latest row that it was given to learn from."""

    name = "witness"
    demo_directions = ()

    def init_state(self, key, env, goals):
        return jnp.zeros((), jnp.int32)

    def update_state(self, method_state, rows, phase):
        return rows.row.max()


def test_a_batch_holds_what_was_stored_before_its_step():
    env = make("cheetah_run", physics="c")
    problem, method = (
        Problem(env, Protocol(env.train_horizon, env.eval_horizon)),
        Witness(SAC(hidden_sizes=(8,), batch_size=64)),
    )
    method = per_lane(method, 2)
    lives = advance(problem, method, newborn(problem, method, [0, 1]), 3, explore=True)
    for step in (3, 4, 5):
        lives = advance(problem, method, lives, 1)
        np.testing.assert_array_equal(lives.lanes.method_state, [step - 1] * 2)


def test_a_step_in_two_halves_is_the_step_in_one(monkeypatch):
    env = make("sawyer_door", physics="c")
    problem = Problem(env, Protocol(env.train_horizon, env.eval_horizon))
    method = tiny_method("naive", demo_share=0.5)
    start = newborn(problem, method, [0, 1], steps=60)
    whole = advance(problem, method, start, 20)
    monkeypatch.setattr(c, "_beside", lambda: True)
    halves = advance(problem, method, start, 20)
    assert_same(whole, halves)
    assert int(whole.step) == 20
