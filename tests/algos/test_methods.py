"""Each method's own functions: goals, phases, rewards, curricula."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax import assets
from earl_jax.algos import Method, list_algos, make_algo, register_algo
from earl_jax.algos.goals import GoalIndices, goal_table
from earl_jax.algos.learner.replay import TransitionBatch, TransitionFlags, unpack
from earl_jax.algos.method import RETURN, TASK
from earl_jax.training.demo_rows import demo_rows
from tests.conftest import ALGOS, LATER_ALGOS, make_train_state, run_whole, take_lane, tiny_method

KEYS = jax.random.split(jax.random.key(0), 300)
CURRENT = GoalIndices(goal=jnp.asarray(2), task=jnp.asarray(3))


def next_goals(method, goals, phase, method_state=()):
    """Return the goal indices [300] of a new `phase` for 300 keys."""
    return jax.jit(jax.vmap(lambda key: method.next_goal(key, goals, jnp.asarray(phase), CURRENT, method_state)))(KEYS)


def make_batch(states, next_states, row, goal):
    """Return transitions with the index `goal`, no reward and no flag."""
    size = len(states)
    no = jnp.zeros(size, bool)
    return TransitionBatch(
        row=jnp.asarray(row),
        state=jnp.asarray(states),
        action=jnp.zeros((size, 3)),
        next_state=jnp.asarray(next_states),
        reward=jnp.zeros(size),
        flags=TransitionFlags(goal=jnp.full(size, goal), reached=no, timeout=no, no_successor=no, absorbed=no),
    )


def test_the_registry_lists_the_methods_and_refuses_unknown_names_and_options():
    assert list_algos() == sorted([*ALGOS, *LATER_ALGOS])
    with pytest.raises(ValueError, match=", ".join(list_algos())):
        make_algo("ppo")
    with pytest.raises(ValueError, match=r"no option 'gamma'.*discount.*epsilon"):
        make_algo("vaprl", gamma=0.9)
    with pytest.raises(ValueError, match="exists already"):
        register_algo("naive", Method)
    assert make_algo("naive", hidden_sizes=[8, 8]).sac.hidden_sizes == (8, 8)


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


@pytest.mark.parametrize("algo", ["naive", "oracle"])
def test_methods_with_one_controller_draw_any_task_goal(env, algo):
    method, goals = make_algo(algo), goal_table(env)
    drawn = next_goals(method, goals, TASK)
    np.testing.assert_array_equal(drawn.goal, drawn.task)
    assert set(np.asarray(drawn.goal).tolist()) == {0, 1, 2, 3}
    assert method.phase_length(env, TASK) == (1000 if algo == "naive" else 200)


def test_naive_by_the_global_clock_times_out_at_multiples_of_its_episode_length(problem):
    method = tiny_method("naive", episode_length=8, global_clock=True)
    state = make_train_state(problem, method, [0, 1])
    first = int(state.replay.row)
    lanes = state.lanes.replace(phase_step=jnp.array([5, 0], jnp.int32))  # the last goal was reached 5 steps ago
    state = run_whole(problem, method, state.replace(lanes=lanes), 16, explore=True)
    timeouts = np.asarray(unpack(state.replay.flags[first : first + 16]).timeout)
    np.testing.assert_array_equal(timeouts, np.tile(np.arange(1, 17)[:, None] % 8 == 0, 2))
    assert make_algo("naive").phase_age(jnp.asarray(3), jnp.asarray(7)) == 7


@pytest.mark.parametrize("fixed", [False, True])
def test_phases_of_fbrl_have_a_fixed_length_on_request(fixed):
    method = make_algo("fbrl", fixed_phases=fixed)
    assert [bool(method.ends_on_success(jnp.asarray(phase))) for phase in (TASK, RETURN)] == [not fixed] * 2


def test_fbrl_with_one_controller_is_one_agent_with_all_demonstrations(problem):
    method = tiny_method("fbrl", controllers=1)
    assert demo_rows(problem, method).listed(0).size == demo_rows(problem, tiny_method("vaprl")).rows.size
    state = jax.eval_shape(lambda: make_train_state(problem, method, [0, 1]))
    assert {leaf.shape[:2] for leaf in jax.tree.leaves(state.lanes.agent.actor)} == {(2, 1)}
    goals = goal_table(problem.env)
    assert (next_goals(method, goals, RETURN).goal == 4).all()
    with pytest.raises(ValueError, match=r"controllers must lie in \[1, 2\], not 3"):
        make_algo("fbrl", controllers=3)


def test_fbrl_returns_to_initial_states_and_keeps_its_task(env):
    method, goals = make_algo("fbrl"), goal_table(env)
    back = next_goals(method, goals, RETURN)
    assert (back.goal == 4).all()
    assert (back.task == 3).all()
    assert set(np.asarray(next_goals(method, goals, TASK).goal).tolist()) == {0, 1, 2, 3}


def test_fbrl_gives_each_controller_its_own_demonstrations(problem):
    demos = demo_rows(problem, make_algo("fbrl"))
    goals = problem.goals.table[demos.goals]
    assert (goals[demos.controllers == 1] == problem.env.initial_states[0]).all()
    assert len(demos.listed(0)) == len(assets.demos(problem.env.name, "forward").ends)
    assert len(demos.listed(1)) == len(assets.demos(problem.env.name, "backward").ends)
    assert not demo_rows(problem, make_algo("r3l")).listed(1).size


def test_r3l_ends_only_the_task_phase_on_success_and_keeps_its_goals_in_the_other(env):
    method, goals = make_algo("r3l"), goal_table(env)
    assert bool(method.ends_on_success(jnp.asarray(TASK)))
    assert not bool(method.ends_on_success(jnp.asarray(RETURN)))
    kept = next_goals(method, goals, RETURN)
    assert (kept.goal == 2).all()
    assert (kept.task == 3).all()


def test_rnd_reward_and_scale_are_the_released_formulas(env):
    method, goals = make_algo("r3l"), goal_table(env)
    method_state = method.init_state(jax.random.key(0), env, goals).replace(sigma=jnp.asarray(0.5))
    states = goals.candidates[:64]
    batch = make_batch(states, states, np.arange(64), 0)
    errors = np.asarray(method_state.error(method_state.predictor, states))
    np.testing.assert_allclose(method.reward(env, goals, batch, RETURN, method_state), errors / 0.5, rtol=1e-5)
    np.testing.assert_array_equal(method.reward(env, goals, batch, TASK, method_state), batch.reward)
    update = jax.jit(lambda method_state, phase: method.update_state(KEYS[0], env, goals, batch, phase, method_state))
    learnt = update(method_state, jnp.asarray(RETURN))
    assert float(learnt.sigma) == pytest.approx(0.99 * 0.5 + 0.01 * max(np.std(errors / 0.5), 1e-3), rel=1e-5)
    after = method_state
    for _ in range(30):
        after = update(after, jnp.asarray(RETURN))
    assert float(after.error(after.predictor, states).mean()) < 0.7 * errors.mean()
    unchanged = update(method_state, jnp.asarray(TASK))
    assert float(unchanged.sigma) == 0.5
    np.testing.assert_array_equal(unchanged.error(unchanged.predictor, states), errors)


def test_vaprl_chooses_the_valued_state_nearest_the_start_or_else_the_best_valued(env):
    method, goals = make_algo("vaprl", epsilon=0.1, nearest_fallback=False), goal_table(env)
    distance = np.linalg.norm(goals.candidates - env.initial_states[0], axis=1)
    values = np.zeros(len(distance), np.float32)
    values[[50, 500, 900]] = [0.2, 0.9, 0.15]
    able = np.array([50, 500, 900])
    assert int(method.choose(jnp.asarray(values), goals)) == able[np.argmin(distance[able])]
    assert int(method.choose(jnp.asarray(values / 100), goals)) == 500
    everything = jnp.ones(len(distance))
    assert distance[int(method.choose(everything, goals))] == distance.min()


def test_vaprl_begins_at_the_state_nearest_the_start(env):
    method, goals = make_algo("vaprl", epsilon=0.1), goal_table(env)
    distance = np.linalg.norm(goals.candidates - env.initial_states[0], axis=1)
    values = jnp.zeros(len(distance)).at[500].set(0.05)
    assert distance[500] > distance.min()
    assert distance[int(method.choose(values, goals))] == distance.min()
    assert int(method.choose(10 * values, goals)) == 500


def test_vaprl_draws_its_next_task_when_it_returns(env):
    method, goals = make_algo("vaprl"), goal_table(env)
    method_state = method.init_state(KEYS[0], env, goals)
    values = method_state.values.at[:, 77].set(1.0)
    back = next_goals(method, goals, RETURN, method_state.replace(values=values))
    assert (back.goal == 5 + 77).all()
    assert set(np.asarray(back.task).tolist()) == {0, 1, 2, 3}
    forward = next_goals(method, goals, TASK, method_state)
    assert (forward.goal == 3).all()
    assert (forward.task == 3).all()


def test_vaprl_values_come_from_the_entropy_free_pair(problem):
    method = tiny_method("vaprl", 1, reward_scale=10.0)
    lane = take_lane(make_train_state(problem, method, [0]).lanes, 0)
    lane_method = take_lane(method, 0)

    @jax.jit
    def values(critics):
        agent = lane.agent.replace(critics=critics)
        return lane_method.refresh(KEYS[0], problem.env, problem.goals, agent, lane.method_state, None).values

    base = values(lane.agent.critics)
    assert base.shape == (4, len(problem.goals.candidates))

    def shift_bias(first, stop, amount):
        critics = jax.tree.map(jnp.copy, lane.agent.critics)
        bias = critics["params"]["hidden_1"]["bias"]
        critics["params"]["hidden_1"]["bias"] = bias.at[0, first:stop].add(amount)
        return critics

    np.testing.assert_allclose(values(shift_bias(0, 2, 5.0)), base, atol=1e-5)
    np.testing.assert_allclose(values(shift_bias(2, 4, 5.0)), base + 0.5, atol=1e-5)


def test_vaprl_recomputes_success_and_reward_of_relabelled_transitions(env):
    method, goals = make_algo("vaprl", relabel_share=1.0, unmet_goals=False), goal_table(env)
    row = len(goals.candidates) + 5
    states = np.tile(env.goal_states[1], (4000, 1))
    batch = make_batch(states, states, np.full(4000, row), 0)
    relabel = jax.jit(lambda batch: method.relabel(jax.random.key(1), env, goals, batch, TASK))
    new = relabel(batch)
    assert len(set(np.asarray(new.flags.goal).tolist())) > 1500
    expected = np.linalg.norm(goals.table[new.flags.goal][:, :4] - env.goal_states[1][:4], axis=1) <= 0.2
    np.testing.assert_array_equal(new.flags.reached, expected)
    np.testing.assert_array_equal(new.reward, expected.astype(np.float32))
    assert expected.any()
    no_successor = batch._replace(flags=batch.flags._replace(no_successor=jnp.ones(4000, bool)))
    assert (relabel(no_successor).flags.goal == 0).all()


def test_vaprl_with_unmet_goals_keeps_the_goal_of_a_state_that_meets_the_new_one(env):
    goals = goal_table(env)
    states = np.tile(env.goal_states[1], (4000, 1))
    batch = make_batch(states, states, np.full(4000, len(goals.candidates) + 5), 0)
    drawn, kept = (
        jax.jit(lambda batch, method=method: method.relabel(jax.random.key(1), env, goals, batch, TASK))(batch)
        for method in (make_algo("vaprl", relabel_share=1.0, unmet_goals=unmet) for unmet in (False, True))
    )
    met = np.asarray(drawn.flags.reached)
    assert 0 < met.sum() < 4000
    np.testing.assert_array_equal(kept.flags.goal, np.where(met, 0, drawn.flags.goal))


def test_vaprl_relabels_demonstrations_with_their_own_later_states(env):
    method, goals = make_algo("vaprl", relabel_share=1.0, unmet_goals=False), goal_table(env)
    row = np.repeat(np.arange(100), 40)
    batch = make_batch(goals.candidates[row], goals.candidates[row + 1], row, 0)
    relabel = jax.jit(lambda batch: method.relabel(jax.random.key(1), env, goals, batch, TASK))
    later = np.asarray(relabel(batch).flags.goal) - 5
    assert (later > row).all()
    assert (later <= goals.ends[row]).all()
    assert len(set(later[row == 60].tolist())) > 20


def test_time_outs_are_terminal_unless_bootstrapped(env):
    goals = goal_table(env)
    batch = make_batch(goals.candidates[:4], goals.candidates[1:5], np.arange(4), 0)
    flags = batch.flags._replace(reached=jnp.array([1, 0, 1, 0], bool), timeout=jnp.array([0, 1, 0, 0], bool))
    batch = batch._replace(flags=flags)
    np.testing.assert_array_equal(make_algo("naive").terminal(batch, TASK), [True, True, True, False])
    bootstrapped = make_algo("naive", timeout_bootstrap=True).terminal(batch, TASK)
    np.testing.assert_array_equal(bootstrapped, [True, False, True, False])
