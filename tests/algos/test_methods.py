"""One contract for all methods, in a table, and the special functions of the paper's five."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import struct

from earl_jax import assets
from earl_jax.algos import SAC, learner_of, make_algo, method_for, register_learner
from earl_jax.algos.goals import GoalIndices, goal_table
from earl_jax.algos.learner.base import Batch
from earl_jax.algos.learner.replay import unpack
from earl_jax.algos.method import RETURN, TASK, Moment, controller_count
from earl_jax.training import loop
from tests.algos.lives import OPTIONS, lived
from tests.algos.transitions import make_batch
from tests.conftest import CHUNK, assert_all_finite, make_train_state, own_algos, run_whole, take_lane, tiny_method
from tests.envs.chain import Chain

KEYS = jax.random.split(jax.random.key(0), 300)
CURRENT = GoalIndices(goal=jnp.asarray(2), task=jnp.asarray(3))
ANY, START = {0, 1, 2, 3}, {4}
METHODS = {
    "bc": (1, 0, (True, True), 200, (ANY, ANY), (START, {3})),
    "fbrl": (2, 0, (True, True), 200, (ANY, ANY), (START, {3})),
    "medal": (2, 0, (True, False), 300, ({3}, {3}), (ANY, ANY)),
    "naive": (1, 0, (True,), 1000, (ANY, ANY)),
    "oracle": (1, 0, (True,), 200, (ANY, ANY)),
    "r3l": (2, 0, (True, False), 200, (ANY, ANY), ({2}, {3})),
    "risc": (1, 1, (True, True), 200, (ANY, ANY), (START, {3})),
    "rlpd": (1, 0, (True,), 1000, (ANY, ANY)),
    "vaprl": (1, 1, (True, True), 200, ({3}, {3})),
}
"""Numbers of controllers and entropy-free pairs; which phases end on success; the steps of a phase; the indices of goals and of
task goals with which a task phase begins, and a return phase, if the goal was 2 and the task 3 before it."""


def next_goals(method, goals, phase, method_state=()):
    """Return the goal indices [300] of a new `phase` for 300 keys."""
    return jax.jit(jax.vmap(lambda key: method.next_goal(key, goals, jnp.asarray(phase), CURRENT, method_state)))(KEYS)


def test_the_registry_lists_the_methods_and_refuses_a_third_controller_and_what_is_no_learner():
    assert own_algos() == list(METHODS)
    for learner, given in ((SAC, r"<class .*SAC'>; did you mean SAC\(\)\?"), (3, "3")):
        with pytest.raises(ValueError, match=f"the learner must be a name or an object of Learner, not {given}"):
            make_algo("naive", learner=learner)
    with pytest.raises(ValueError, match=r"controllers must lie in \[1, 2\], not 3"):
        make_algo("fbrl", controllers=3)
    with pytest.raises(ValueError, match="the task must be an object of Env, not 'sawyer_door'"):
        method_for("sawyer_door", "naive")  # pyright: ignore[reportArgumentType]


class Tiled(SAC):
    name = "tiled"
    tiles: tuple[int, ...] = struct.field(pytree_node=False, default=(4,))


def test_a_list_is_sizes_for_a_static_option_and_has_a_value_for_each_lane_for_another(registries):
    register_learner("tiled", Tiled)
    options = {"learner": "tiled", "tiles": np.array([8, 8]), "discount": [0.5, 0.9]}
    for learner in (make_algo("naive", **options).learner, learner_of(options)):
        assert learner.tiles == (8, 8)
        assert learner.discount.tolist() == pytest.approx([0.5, 0.9])
    with pytest.raises(ValueError, match=r"precision must be text, not \('bf16',\)"):
        make_algo("naive", precision=["bf16"])


@pytest.mark.parametrize("algo", METHODS)
def test_a_method_has_its_phases_and_goals(env, algo):
    method, goals = make_algo(algo), goal_table(env)
    controllers, pairs, ends, steps, *goals_of_phases = METHODS[algo]
    assert (method.name, controller_count(method), method.entropy_free_pairs) == (algo, controllers, pairs)
    assert {phase.resets for phase in method.phases} == {algo == "oracle"}
    assert tuple(phase.ends_on_success for phase in method.phases) == ends
    if algo != "risc":  # whose phases can end earlier: tests/algos/test_risc.py
        for phase in range(len(ends)):
            moments = (
                Moment(jnp.asarray(7), jnp.asarray(phase), jnp.asarray(age), KEYS[0]) for age in (steps - 2, steps - 1)
            )
            assert [bool(method.ends_phase(KEYS[0], env, None, None, at, ())) for at in moments] == [False, True]
    method_state = method.init(KEYS[0], env, goals) if algo == "vaprl" else ()
    for phase, expected in enumerate(goals_of_phases):
        drawn = next_goals(method, goals, phase, method_state)
        assert tuple(set(indices.tolist()) for indices in drawn) == expected
        if expected == (ANY, ANY):
            np.testing.assert_array_equal(drawn.goal, drawn.task)


@pytest.mark.parametrize("algo", OPTIONS)
def test_a_method_beyond_the_papers_lives_for_some_steps(algo):
    """The paper's five do so in tests/training/test_loop.py."""
    method, start, end = lived(algo)
    assert_all_finite((end.replay, end.lanes.agent, end.lanes.method_state))
    assert (end.replay.counts - start.replay.counts).sum(axis=1).tolist() == [CHUNK] * 2
    kernels = [np.asarray(jax.tree.leaves(state.lanes.agent.actor)[-1]) for state in (start, end)]
    moved = np.abs(kernels[1] - kernels[0]).reshape(2, controller_count(method), -1).max(axis=-1)
    assert (moved > 0).all() == (algo != "bc")


def test_a_way_back_leads_to_any_initial_state(env):
    goals = goal_table(env)._replace(tasks=3, initials=2)
    assert set(next_goals(make_algo("fbrl"), goals, RETURN).goal.tolist()) == {3, 4}


def test_the_goal_table_holds_tasks_starts_and_every_demonstrated_state(env):
    goals = goal_table(env)
    np.testing.assert_array_equal(goals.table[:4], env.goal_states)
    np.testing.assert_array_equal(goals.table[4:5], env.initial_states)
    forward, backward = (assets.demos(env.name, direction) for direction in assets.DIRECTIONS)
    assert len(goals.candidates) == len(forward.ends) + len(backward.ends) + 24
    assert goals.ends.max() == len(goals.candidates) - 1
    last = np.unique(goals.ends)
    np.testing.assert_array_equal(goals.candidates[last[0]], forward.next_states[forward.ends][0])
    assert len(last) == 24


def test_the_goal_table_follows_a_task_that_autoreload_has_changed(monkeypatch):
    """It kept the former goals, also after `jax.clear_caches()`, while the task drew the new ones."""
    goal_table(Chain())
    monkeypatch.setattr(Chain, "goal_states", property(lambda self: np.array([[2.0], [1.0]], np.float32)))
    assert goal_table(Chain()).table.ravel().tolist() == [2.0, 1.0, 0.0]


def test_naive_by_the_global_clock_times_out_at_multiples_of_its_episode_length(problem):
    method = tiny_method("naive", episode_length=8, global_clock=True)
    state = make_train_state(problem, method, [0, 1])
    first = int(state.replay.row)
    lanes = state.lanes.replace(phase_step=jnp.array([5, 0], jnp.int32))  # the last goal was reached 5 steps ago
    state = run_whole(problem, method, state.replace(lanes=lanes), 16, warmup=True)
    timeouts = np.asarray(unpack(state.replay.flags[first : first + 16]).timeout)
    np.testing.assert_array_equal(timeouts, np.tile(np.arange(1, 17)[:, None] % 8 == 0, 2))


def test_rnd_reward_and_scale_are_the_released_formulas(env):
    method, goals = make_algo("r3l", hidden_sizes=[16]), goal_table(env)
    state = jax.jit(lambda key: method.init(key, env, goals))(KEYS[0]).replace(sigma=jnp.asarray(0.5))
    batch = make_batch(goals.candidates[:64], goals.candidates[64:128])
    rewards = jax.jit(lambda phase, method=method: method.prepare(KEYS[0], env, goals, batch, phase, state).reward)
    agent = jax.jit(lambda key: method.learner.init(key, 12, 3))(KEYS[1])
    obs, zeros = np.concatenate([batch.state, batch.state], axis=1), np.zeros(64, np.float32)
    learnt = Batch(obs, batch.action, zeros, zeros > 0, obs)
    update = jax.jit(lambda state, phase: method.learn(KEYS[0], env, agent, learnt, phase, state)[1])
    errors = jax.jit(lambda state: state.error(state.predictor, batch.state))
    before = np.asarray(errors(state))
    np.testing.assert_allclose(rewards(RETURN), before / 0.5, rtol=1e-5)
    clipped = rewards(RETURN, method.replace(rnd_clip=np.median(before)))
    np.testing.assert_allclose(clipped, np.minimum(before / 0.5, np.median(before)), rtol=1e-5)
    np.testing.assert_array_equal(rewards(TASK), batch.reward)
    expected = 0.99 * 0.5 + 0.01 * max(np.std(before / 0.5), 1e-3)
    assert float(update(state, RETURN).sigma) == pytest.approx(expected, rel=1e-5)
    undecayed = jax.jit(method.replace(rnd_decay=0.0).distil)(state.replace(sigma=jnp.asarray(1e6)), batch.state)
    assert float(undecayed.sigma) == pytest.approx(1e-3)
    after = state
    for _ in range(30):
        after = update(after, RETURN)
    assert errors(after).mean() < 0.7 * before.mean()
    unchanged = update(state, TASK)
    assert float(unchanged.sigma) == 0.5
    np.testing.assert_array_equal(errors(unchanged), before)


def test_the_preset_of_rlpd_has_its_papers_learner_and_updates_the_whole_ensemble_as_often_as_asked():
    sac = make_algo("rlpd").learner
    values = sac.timeout_bootstrap, sac.layer_norm, sac.demo_share, sac.ensemble, sac.target_subset, sac.backup_entropy
    assert values == (True, True, 0.5, 10, 2, False)
    _, start, end = lived("rlpd")
    agent = end.lanes.agent
    assert {leaf.shape[:3] for leaf in jax.tree.leaves(agent.critics)} == {(2, 1, 4)}
    np.testing.assert_array_equal(agent.moments["critics"].count, [[3 * CHUNK], [3 * CHUNK]])
    np.testing.assert_array_equal(agent.moments["actor"].count, [[CHUNK], [CHUNK]])
    for old, new in zip(*(jax.tree.leaves(state.lanes.agent.critics) for state in (start, end)), strict=True):
        assert (np.abs(np.asarray(new) - np.asarray(old)).max(axis=tuple(range(3, old.ndim))) > 0).all()


@pytest.mark.parametrize("fallback", [False, True])
def test_vaprl_chooses_the_valued_state_nearest_the_start_or_a_fallback(env, fallback):
    method, goals = make_algo("vaprl", epsilon=0.1, nearest_fallback=fallback), goal_table(env)
    choose = jax.jit(lambda values: method.choose(values, goals))
    distance = np.linalg.norm(goals.candidates - env.initial_states[0], axis=1)
    values, able = np.zeros(len(distance), np.float32), np.array([50, 500, 900])
    values[able] = [0.2, 0.9, 0.15]
    assert int(choose(values)) == able[np.argmin(distance[able])]
    assert distance[500] > distance.min()
    assert distance[int(choose(values / 100))] == (distance.min() if fallback else distance[500])
    ones = np.ones(len(distance), np.float32)
    assert distance[int(choose(ones))] == distance.min()
    two_starts = goals._replace(tasks=3, initials=2)
    between = np.linalg.norm(goals.candidates - goals.table[3:5].mean(axis=0), axis=1)
    assert between[int(method.choose(ones, two_starts))] == pytest.approx(between.min())


def test_vaprl_draws_its_next_task_when_it_returns(env):
    method, goals = make_algo("vaprl"), goal_table(env)
    values = jnp.zeros((goals.tasks, len(goals.candidates))).at[:, 77].set(1.0)
    back = next_goals(method, goals, RETURN, method.init(KEYS[0], env, goals).replace(values=values))
    assert (back.goal == 5 + 77).all()
    assert set(back.task.tolist()) == ANY


def test_vaprl_averages_the_value_of_each_candidate_over_actions(problem):
    method = take_lane(tiny_method("vaprl", 1, reward_scale=10.0, value_samples=3), 0)
    lane = take_lane(make_train_state(problem, tiny_method("vaprl", 1), [0]).lanes, 0)

    @jax.jit
    def by_hand(obs):
        agent, keys = take_lane(lane.agent, 0), jax.random.split(KEYS[0], method.value_samples)
        return jnp.stack([method.learner.value(key, agent, obs) for key in keys]).mean(axis=0) / 10

    refresh = jax.jit(lambda: method.refresh(KEYS[0], problem.env, problem.goals, lane.agent, None, lane.method_state))
    states = problem.goals.candidates
    obs = np.concatenate([np.tile(states, (4, 1)), np.repeat(problem.goals.table[:4], len(states), axis=0)], axis=1)
    np.testing.assert_allclose(refresh().values, by_hand(obs).reshape(4, -1), atol=1e-5)


RELABELLING = {unmet: make_algo("vaprl", relabel_share=1.0, unmet_goals=unmet) for unmet in (False, True)}
"""VaPRL with another goal for every transition; with `unmet_goals`, only if its state does not meet it."""


@pytest.fixture(scope="module")
def relabel(env):
    return jax.jit(lambda method, batch: method.prepare(jax.random.key(1), env, goal_table(env), batch, TASK, ()))


@pytest.fixture(scope="module")
def batch(env):
    """4000 transitions that were not demonstrated, at the second goal."""
    states, goals = np.tile(env.goal_states[1], (4000, 1)), goal_table(env)
    return make_batch(states, states, row=np.full(4000, len(goals.candidates) + 5))


def test_vaprl_recomputes_success_and_reward_of_relabelled_transitions(env, relabel, batch):
    batch = batch._replace(state=np.tile(env.goal_states[2], (4000, 1)))
    new = relabel(RELABELLING[False], batch)
    assert len(set(new.flags.goal.tolist())) > 1500
    goals = goal_table(env).table[new.flags.goal]
    expected = np.linalg.norm(goals[:, :4] - env.goal_states[1][:4], axis=1) <= 0.2
    np.testing.assert_array_equal(new.flags.reached, expected)
    np.testing.assert_array_equal(new.reward, expected.astype(np.float32))
    assert expected.any()
    ended = batch._replace(flags=batch.flags._replace(no_successor=jnp.ones(4000, bool)))
    assert (relabel(RELABELLING[False], ended).flags.goal == 0).all()


def test_vaprl_keeps_the_goal_of_a_state_that_meets_the_new_one(relabel, batch):
    drawn, kept = (relabel(RELABELLING[unmet], batch) for unmet in (False, True))
    met = np.asarray(drawn.flags.reached)
    assert 0 < met.sum() < 4000
    np.testing.assert_array_equal(kept.flags.goal, np.where(met, 0, drawn.flags.goal))


def test_vaprl_relabels_demonstrations_with_their_own_later_states(env, relabel):
    goals, row = goal_table(env), np.repeat(np.arange(100), 40)
    batch = make_batch(goals.candidates[row], goals.candidates[row + 1], row=row)
    later = np.asarray(relabel(RELABELLING[False], batch).flags.goal) - 5
    assert (later > row).all()
    assert (later <= goals.ends[row]).all()
    assert len(set(later[row == 60].tolist())) > 20


def test_time_outs_are_terminal_unless_bootstrapped(problem):
    batch = make_batch(*np.zeros((2, 4, 6)))
    flags = batch.flags._replace(reached=np.array([1, 0, 1, 0], bool), timeout=np.array([0, 1, 0, 0], bool))
    for bootstrap, expected in ((False, [True, True, True, False]), (True, [True, False, True, False])):
        method = make_algo("naive", timeout_bootstrap=bootstrap)
        assert loop.batch_of(problem, method, batch._replace(flags=flags), 0).terminal.tolist() == expected
