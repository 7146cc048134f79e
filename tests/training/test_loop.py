"""The training step: deterministic, independent of the number of lanes, with correct phases and batches."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.algos import SAC, Method
from earl_jax.algos.goals import GoalIndices
from earl_jax.algos.learner.replay import sample_own, unpack
from earl_jax.algos.method import RETURN, TASK
from earl_jax.envs import make
from earl_jax.physics.engines import c
from earl_jax.training import loop, scan
from earl_jax.training.init import init_train_state
from earl_jax.training.ordering import UNLIKELY, read_before_write
from earl_jax.training.plan import per_lane
from earl_jax.training.state import seed_keys
from tests.conftest import (
    CHUNK,
    advance,
    assert_all_finite,
    assert_equal_trees,
    lane_rules,
    make_problem,
    make_train_state,
    run_whole,
    stored_flags,
    take_lane,
    tiny_method,
)
from tests.envs.chain import Chain

EXPERT_STEPS = 4820
"""Whole cycles of R3L with an expert: 41 steps to the goal and 200 of perturbation."""


@pytest.mark.parametrize("algo", ["naive", "vaprl"])
def test_chunks_equal_one_scan_bit_for_bit(problem, algo):
    """The scan of VaPRL has a block for each refresh, as long as a chunk."""
    method = tiny_method(algo)
    start = make_train_state(problem, method, [0, 1])
    whole = run_whole(problem, method, start, 60)
    chunked = advance(problem, method, start, 60)
    assert_all_finite(chunked.lanes.agent)
    assert_equal_trees(chunked, whole)
    assert int(whole.step) == 60


def test_a_seed_lives_the_same_alone_and_beside_others(problem):
    """What it learns is compared in tests/sweeps/test_worker.py."""
    lives = [(tiny_method("fbrl", len(seeds)), seeds) for seeds in ([4, 5], [5])]
    beside, alone = (advance(problem, own, make_train_state(problem, own, seeds), 40, True) for own, seeds in lives)
    last = take_lane(beside.lanes, slice(1, 2))
    assert_equal_trees(last.env_state, alone.lanes.env_state, rtol=1e-4, atol=1e-4)
    assert_equal_trees(last.goal_indices, alone.lanes.goal_indices)
    np.testing.assert_allclose(beside.replay.action[:, 1], alone.replay.action[:, 0], atol=1e-4)
    np.testing.assert_array_equal(beside.replay.index[:, 1], alone.replay.index[:, 0])


def acted(problem, method, steps, rules=None):
    """Return four fresh lanes after `steps` steps, in one program, since the tests replace its actions and its updates."""
    state = make_train_state(problem, method, range(4), EXPERT_STEPS, rules)
    return run_whole(problem, method, state, steps)


@pytest.fixture
def expert_acts(monkeypatch):
    """Let the scripted expert act in place of every learnt controller, which returns home in R3L's second phase."""

    def act(self, key, env, actor, obs, moment, method_state):
        home = jnp.concatenate([obs[: env.state_size], env.initial_states[0]])
        return env.demonstrations.expert(jnp.where((moment.phase == RETURN) & (self.name == "r3l"), home, obs))

    monkeypatch.setattr(Method, "act", act)
    monkeypatch.setattr(loop, "update_lane", lambda problem, method, lane, *rest: lane)


@pytest.mark.parametrize(("algo", "published"), [("oracle", 41.0), ("fbrl", 82.5), ("r3l", 240.0)])
def test_experts_in_the_loop_earn_at_the_published_rate(problem, expert_acts, algo, published):
    """Scripted optima that the converged reward rates of the paper's runs imply, in env steps per reached goal."""
    counters = acted(problem, tiny_method(algo, 4), EXPERT_STEPS).lanes.counters
    assert 4 * EXPERT_STEPS / float(counters.reached.sum()) == pytest.approx(published, rel=0.05)
    interventions = np.asarray(counters.interventions)
    assert (interventions == counters.reached).all() if algo == "oracle" else not interventions.any()
    if algo != "r3l":  # whose perturbation begins at the goal
        assert int(counters.reached.sum()) == int(counters.window_reward.sum())


def test_goals_that_the_environment_sets_change_by_the_clock_alone(problem, expert_acts):
    """An attempt at the task follows a goal change at once; a return goes on to its own end."""
    state = acted(problem, tiny_method("fbrl", 4), 400, lane_rules([0] * 4, [0.0] * 4, [100] * 4))
    goals = stored_flags(state, 400).goal
    is_task = goals < len(problem.env.goal_states)
    assert 0.1 < is_task.mean() < 0.9
    tasks = [
        np.unique(goals[first : first + 100, lane][is_task[first : first + 100, lane]])
        for first in range(0, 400, 100)
        for lane in range(4)
    ]
    assert [len(found) for found in tasks] == [1] * 16, "a task lasts for 100 steps"
    assert len(np.unique(tasks)) > 1
    assert 16 < float(state.lanes.counters.window_reward.sum()) < 80


def test_a_phase_of_a_fixed_length_is_rewarded_at_each_step_at_its_goal_and_counts_as_reached(problem, expert_acts):
    state = acted(problem, tiny_method("fbrl", 4, fixed_phases=True), 400)
    batch = sample_own(state.replay, state.lanes.key, TASK, 500)
    goals = problem.goals.table[batch.flags.goal]
    success = problem.env.success(jnp.concatenate([batch.next_state, goals], axis=-1))
    assert 0.2 < success.mean() < 0.9
    np.testing.assert_array_equal(batch.reward, success)
    assert not batch.flags.reached.any()
    counters = state.lanes.counters
    assert counters.reached.tolist() == [1] * 4
    assert counters.phases.ended.tolist() == counters.phases.reached.tolist() == [[1, 1]] * 4
    demonstrated = unpack(state.replay.flags[: int(state.replay.first_row)])
    assert demonstrated.passed.any()
    assert not demonstrated.reached.any()


class Recorder(Method):
    """Acts out of bounds, counts its refreshes and remembers the latest row that it learnt from, told by its rewards."""

    name = "recorder"
    refresh_every = 16

    def init(self, key, env, goals):
        return {"refreshes": jnp.zeros((), jnp.int32), "row": jnp.zeros((), jnp.int32)}

    def act(self, *_):
        return jnp.array([5.0])

    def refresh(self, key, env, goals, agent, batch, method_state):
        return {**method_state, "refreshes": method_state["refreshes"] + 1}

    def prepare(self, key, env, goals, batch, phase, method_state):
        return batch._replace(reward=batch.row.astype(jnp.float32))

    def learn(self, key, env, agent, batch, phase, method_state):
        agent, _, diagnostics = super().learn(key, env, agent, batch, phase, method_state)
        return agent, {**method_state, "row": batch.reward.max().astype(jnp.int32)}, diagnostics


@pytest.fixture(scope="module")
def recorded():
    """Two lanes that start without any transition: their problem, their method and their first state."""
    problem = make_problem(Chain(train_horizon=0, eval_horizon=8))
    method = per_lane(Recorder(SAC(hidden_sizes=(8,), batch_size=256, random_steps=0)), 2)
    return problem, method, make_train_state(problem, method, [0, 1])


def test_a_batch_holds_earlier_transitions_with_clipped_actions_and_a_refresh_begins_every_block(recorded):
    """A call of 20 steps has blocks of 4 steps, since 16 does not divide it."""
    assert recorded[-1].lanes.visits is None, "the task has no map"
    state = advance(*recorded, CHUNK)
    np.testing.assert_array_equal(state.lanes.method_state["refreshes"], [5, 5])
    np.testing.assert_array_equal(state.lanes.method_state["row"], [CHUNK - 2] * 2)
    assert np.unique(state.replay.action[:CHUNK]).tolist() == [1.0], "as the environment takes them"


def test_what_functions_of_a_method_return_has_its_shape_and_kind():
    """DDPG used to learn from a column of rewards as from a matrix, and a time-out of 2 used to be no time-out."""
    problem, keys = make_problem(Chain()), seed_keys([0, 1])

    def lived(**functions):
        members = {"name": "odd", "refresh_every": 2, **functions}
        learner = members.pop("learner", SAC)(hidden_sizes=(8,), batch_size=16)
        method = per_lane(type("Odd", (Method,), members)(learner), 2)
        return scan.run_steps(problem, method, init_train_state(problem, method, keys, 4), 4)

    same = "with the same leaves, but"
    for name, function, message in (
        ("next_goal", lambda *_: GoalIndices(*[jnp.zeros(1)] * 2), r"next_goal returns must be index\[\], not float32\[1\]"),
        ("act", lambda *_: [1, 1], r"the action from act must be number\[1\], not float32\[2\]"),
        ("ends_phase", lambda *_: 2, r"ends_phase returns must be bool\[\], not int32\[\]"),
        ("ends_phase", lambda *_: None, r"ends_phase returns must be bool\[\], not None"),
        ("prepare", lambda *_: None, r"prepare must return TransitionBatch\(row, .*, not an object of NoneType"),
        ("prepare", lambda *of: of[4]._replace(reward=of[4].reward[:, None]), r"the reward .*, not float32\[16, 1\]"),
        ("prepare", lambda *of: of[4]._replace(goal=of[4].reward), r"goal from .* number\[16, 1\], not float32\[16\]"),
        ("prepare", lambda *of: of[4]._replace(state=of[4].state[:, :0]), r"obs from .* number\[16, 2\], not float32\[16, 1\]"),
        ("learn", lambda *_: None, rf"learn must return .*Learner.diagnostics\) {same} \[0\].* was .*\[8\] and is missing"),
        ("learn", lambda *of: (of[3], of[6], {"loss": 1.0}), rf"{same} \[2\]\['critic_loss'\] was float32\[\] and is missing"),
        ("pretrain", lambda *_: None, rf"pretrain must return the agent {same} .* was float32\[.*\] and is missing"),
        ("refresh", lambda *_: jnp.zeros((), int), rf"refresh must return method_state {same} it was missing and is int32\[2\]"),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=f"odd: .*{message}"):
            jax.eval_shape(functools.partial(lived, **{name: function}))
    assert jax.eval_shape(functools.partial(lived, act=lambda *_: [1])).replay.action.dtype == jnp.float32
    learner = type("Odd", (SAC,), {"name": "mine", "update": lambda self, key, agent, batch: (agent, {})})
    with pytest.raises(ValueError, match=r"mine: update must return \(agent, diagnostics\) .* \[1\]\['critic_loss'\]"):
        jax.eval_shape(functools.partial(lived, learner=learner))


def test_a_life_that_starts_empty_learns_from_its_second_step_on(recorded):
    """Its first batch was a row of zeros that nothing had written."""
    problem, method, start = recorded
    first = advance(problem, method, start, 1)
    second = advance(problem, method, first, 1)
    assert_equal_trees(first.lanes.agent, start.lanes.agent)
    assert first.lanes.counters.diagnostics["temperature"].tolist() == [0.0, 0.0]
    assert (np.asarray(second.lanes.agent.log_temperature) != start.lanes.agent.log_temperature).all()


def test_a_refresh_uses_the_agent_of_its_step(problem):
    method = tiny_method("vaprl")
    start = make_train_state(problem, method, [0, 1])
    assert not start.lanes.method_state.values.any()
    expected = jax.jit(functools.partial(scan.refresh, problem))(method, start).lanes.method_state.values
    np.testing.assert_allclose(advance(problem, method, start, 20).lanes.method_state.values, expected, atol=1e-5)
    assert np.abs(advance(problem, method, start, 40).lanes.method_state.values - expected).max() > 1e-4


def test_batches_drawn_ahead_are_those_of_each_step(problem, monkeypatch):
    """As on an accelerator, which draws the next step's batch while it learns."""
    method = tiny_method("fbrl")
    start = make_train_state(problem, method, [0, 1])
    expected = advance(problem, method, start, CHUNK)
    monkeypatch.setattr(scan, "_draws_ahead", lambda *_: True)
    ahead = run_whole(problem, method, start, CHUNK)
    assert_equal_trees(ahead.replay.index, expected.replay.index)
    assert_equal_trees(ahead.lanes.env_state, expected.lanes.env_state, rtol=1e-5, atol=1e-6)
    assert_equal_trees(ahead.lanes.agent, expected.lanes.agent, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize(("algo", "capacity"), [("naive", CHUNK), ("fbrl", CHUNK // 2)])
def test_demonstrations_are_sampled_until_own_steps_fill_the_replay_or_kept(problem, algo, capacity):
    """Two controllers have twice the capacity of one."""
    method = tiny_method(algo, replay_capacity=capacity, batch_size=1024)
    state = advance(problem, method, make_train_state(problem, method, [0, 1]), CHUNK, warmup=True)
    rows = jax.jit(lambda method, step: loop.sample(method, state.replace(step=step), state.lanes.key)[1].row)
    for keep_demos in (True, False):
        own = tiny_method(algo, replay_capacity=capacity, batch_size=1024, keep_demos=keep_demos)
        demonstrated = [bool((rows(own, step) < state.replay.first_row).any()) for step in (CHUNK - 1, CHUNK)]
        assert demonstrated == [True, keep_demos]


def test_a_step_started_on_the_host_and_finished_later_equals_a_whole_step(door, monkeypatch):
    method = tiny_method("fbrl", demo_share=0.5)
    start = make_train_state(door, method, [0, 1])
    assert not scan.host_simulates(door, start)
    whole = advance(door, method, start, CHUNK)
    monkeypatch.setattr(c, "_host_runs_beside_device", lambda: True)
    assert scan.host_simulates(door, start)
    assert_equal_trees(run_whole(door, method, start, CHUNK), whole)


def test_the_next_row_depends_on_every_array_of_a_batch_as_the_compiler_keeps_it_and_stays_the_same(problem):
    state = make_train_state(problem, tiny_method("fbrl"), [0, 1])
    batch = {"state": jnp.full(3, 0.5), "flags": (jnp.zeros(2, bool),)}
    row = jax.jit(lambda state, batch: read_before_write(state, batch)[0].replay.row)
    lowered = row.lower(state, batch)
    assert lowered.as_text().partition("@main(")[2].partition("->")[0].count("%arg") == 3
    assert f"constant({{{UNLIKELY:g}}})" in lowered.compile().as_text()
    assert (int(row(state, batch)), row(state, batch).dtype) == (int(state.replay.row), state.replay.row.dtype)


def test_the_task_is_rewarded_whichever_controller_acts(env, problem):
    """A lane that stands on its task goal while the backward controller acts goes on earning."""
    method = tiny_method("fbrl")
    state = make_train_state(problem, method, [0, 1])
    goal = jnp.asarray(env.goal_states[1])
    data = state.lanes.env_state.data.replace(qpos=jnp.tile(goal[:4], (2, 1)))
    env_state = state.lanes.env_state.replace(data=data, obs=jnp.tile(goal, (2, 2)))
    goal_indices = state.lanes.goal_indices._replace(goal=jnp.array([4, 4]), task=jnp.array([1, 1]))
    lanes = state.lanes.replace(env_state=env_state, goal_indices=goal_indices, phase=jnp.array([RETURN, RETURN]))
    after = advance(problem, method, state.replace(lanes=lanes), 1, warmup=True)
    assert after.lanes.counters.window_reward.tolist() == [1.0, 1.0]
    assert after.lanes.counters.reached.tolist() == [0, 0]
    assert after.lanes.phase.tolist() == [RETURN, RETURN]


def test_a_return_to_the_start_is_rewarded_for_its_own_goal():
    """It is the only phase whose reward the task computes again; the others learn from that of the step."""
    problem = make_problem(make("minitaur_pen", engine="c", eval_horizon=6), eval_every=40, eval_episodes=2)
    method = tiny_method("fbrl")
    step = jax.jit(lambda method, state: scan.run_steps(problem, method, state, 1))
    goal_reward = jax.jit(jax.vmap(problem.env.goal_reward))
    after, returns = make_train_state(problem, method, [0, 1], 24), 0
    for _ in range(24):
        before, after = after, step(method, after)
        goal = before.lanes.env_state.info["goal"]
        returning = (np.asarray(before.lanes.phase) == RETURN) & (np.asarray(after.lanes.phase_step) > 0)
        stored = np.asarray(after.replay.reward[int(before.replay.row)])
        expected = np.asarray(goal_reward(after.lanes.env_state, goal))
        np.testing.assert_allclose(stored[returning], expected[returning], rtol=1e-4, atol=1e-5)
        returns += returning.sum()
    assert returns >= 20
    assert np.asarray(after.lanes.counters.reached).tolist() == [0, 0], "a dense reward ends no phase"
