"""What each method adds, by itself: goals, phases, rewards, curricula."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax import assets
from earl_jax.algos import Method, list_algos, make_algo, register_algo
from earl_jax.algos.learner.replay import TransitionFlags, TransitionBatch
from earl_jax.algos.goals import GoalIndices, goal_table
from earl_jax.algos.method import RETURN, TASK
from earl_jax.training.init import demo_rows
from tests.conftest import ALGOS, newborn, tiny_method

KEYS = jax.random.split(jax.random.key(0), 300)
LANE = GoalIndices(jnp.asarray(2), jnp.asarray(3))


def commanded(method, goals, phase, method_state=()):
    """Goals and tasks [300] of beginning `phase` with 300 keys."""
    return jax.vmap(lambda key: method.next_goal(key, goals, jnp.asarray(phase), LANE, method_state))(KEYS)


def rows_of(env, goals, states, next_states, row, goal):
    size = len(states)
    no = jnp.zeros(size, bool)
    flags = TransitionFlags(jnp.full(size, goal), no, no, no, no)
    return TransitionBatch(
        jnp.asarray(row), jnp.asarray(states), jnp.zeros((size, 3)), jnp.asarray(next_states), jnp.zeros(size), flags
    )


def test_the_registry_names_five_methods_and_their_choices():
    assert list_algos() == ALGOS
    with pytest.raises(ValueError, match="fbrl, naive, oracle, r3l, vaprl"):
        make_algo("medal")
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
def test_one_controller_draws_task_goals_the_current_one_included(env, algo):
    method, goals = make_algo(algo), goal_table(env)
    found = commanded(method, goals, TASK)
    np.testing.assert_array_equal(found.goal, found.task)
    assert set(np.asarray(found.goal).tolist()) == {0, 1, 2, 3}
    assert method.phase_length(env, TASK) == (1000 if algo == "naive" else 200)


def test_fbrl_returns_to_initial_states_and_keeps_its_task_meanwhile(env):
    method, goals = make_algo("fbrl"), goal_table(env)
    back = commanded(method, goals, RETURN)
    assert (back.goal == 4).all()
    assert (back.task == 3).all()
    assert set(np.asarray(commanded(method, goals, TASK).goal).tolist()) == {0, 1, 2, 3}


def test_fbrl_gives_each_controller_its_own_demonstrations(problem):
    rows = demo_rows(problem, make_algo("fbrl"))
    goals = problem.goals.table[rows.goals]
    assert (goals[rows.controllers == 1] == problem.env.initial_states[0]).all()
    assert len(rows.listed(0)) == len(assets.demos(problem.env.name, "forward").ends)
    assert len(rows.listed(1)) == len(assets.demos(problem.env.name, "backward").ends)
    assert not demo_rows(problem, make_algo("r3l")).listed(1).size


def test_r3l_perturbs_for_novelty_and_never_ends_early(env):
    method, goals = make_algo("r3l"), goal_table(env)
    assert bool(method.ends_on_success(jnp.asarray(TASK)))
    assert not bool(method.ends_on_success(jnp.asarray(RETURN)))
    kept = commanded(method, goals, RETURN)
    assert (kept.goal == 2).all()
    assert (kept.task == 3).all()


def test_rnd_reward_and_scale_are_the_released_formulas(env):
    method, goals = make_algo("r3l"), goal_table(env)
    method_state = method.init_state(jax.random.key(0), env, goals).replace(sigma=jnp.asarray(0.5))
    states = goals.candidates[:64]
    rows = rows_of(env, goals, states, states, np.arange(64), 0)
    errors = np.asarray(method_state.error(method_state.predictor, states))
    np.testing.assert_allclose(method.reward(rows, RETURN, method_state), errors / 0.5, rtol=1e-5)
    np.testing.assert_array_equal(method.reward(rows, TASK, method_state), rows.reward)
    learnt = method.update_state(method_state, rows, jnp.asarray(RETURN))
    assert float(learnt.sigma) == pytest.approx(0.99 * 0.5 + 0.01 * max(np.std(errors / 0.5), 1e-3), rel=1e-5)
    after = method_state
    for _ in range(30):
        after = method.update_state(after, rows, jnp.asarray(RETURN))
    assert float(after.error(after.predictor, states).mean()) < 0.7 * errors.mean()
    still = method.update_state(method_state, rows, jnp.asarray(TASK))
    assert float(still.sigma) == 0.5
    np.testing.assert_array_equal(still.error(still.predictor, states), errors)


def test_vaprl_chooses_the_nearest_able_state_or_else_the_best(env):
    method, goals = make_algo("vaprl", epsilon=0.1), goal_table(env)
    distance = np.linalg.norm(goals.candidates - env.initial_states[0], axis=1)
    values = np.zeros(len(distance), np.float32)
    values[[50, 500, 900]] = [0.2, 0.9, 0.15]
    able = np.array([50, 500, 900])
    assert int(method.choose(jnp.asarray(values), goals)) == able[np.argmin(distance[able])]
    assert int(method.choose(jnp.asarray(values / 100), goals)) == 500
    everything = jnp.ones(len(distance))
    assert distance[int(method.choose(everything, goals))] == distance.min()


def test_vaprl_queues_its_task_while_it_returns(env):
    method, goals = make_algo("vaprl"), goal_table(env)
    method_state = method.init_state(KEYS[0], env, goals)
    values = method_state.values.at[:, 77].set(1.0)
    back = commanded(method, goals, RETURN, method_state.replace(values=values))
    assert (back.goal == 5 + 77).all()
    assert set(np.asarray(back.task).tolist()) == {0, 1, 2, 3}
    on = commanded(method, goals, TASK, method_state)
    assert (on.goal == 3).all()
    assert (on.task == 3).all()


def test_vaprl_values_come_from_the_entropy_free_pair(problem):
    method = tiny_method("vaprl", 1, reward_scale=10.0)
    lane = jax.tree.map(lambda leaf: leaf[0], newborn(problem, method, [0]).lanes)
    one = jax.tree.map(lambda leaf: leaf[0], method)

    def values(critics):
        agent = lane.agent.replace(critics=critics)
        return one.refresh(KEYS[0], problem.env, problem.goals, agent, lane.method_state).values

    base = values(lane.agent.critics)
    assert base.shape == (4, len(problem.goals.candidates))

    def last_bias(first, stop, amount):
        critics = jax.tree.map(jnp.copy, lane.agent.critics)
        bias = critics["params"]["hidden_2"]["bias"]
        critics["params"]["hidden_2"]["bias"] = bias.at[0, first:stop].add(amount)
        return critics

    np.testing.assert_allclose(values(last_bias(0, 2, 5.0)), base, atol=1e-5)
    np.testing.assert_allclose(values(last_bias(2, 4, 5.0)), base + 0.5, atol=1e-5)


def test_vaprl_relabels_and_judges_anew(env):
    method, goals = make_algo("vaprl", relabel_share=1.0), goal_table(env)
    lived = len(goals.candidates) + 5
    states = np.tile(env.goal_states[1], (4000, 1))
    rows = rows_of(env, goals, states, states, np.full(4000, lived), 0)
    new = method.relabel(jax.random.key(1), env, goals, rows)
    assert len(set(np.asarray(new.flags.goal).tolist())) > 1500
    truth = np.linalg.norm(goals.table[new.flags.goal][:, :4] - env.goal_states[1][:4], axis=1) <= 0.2
    np.testing.assert_array_equal(new.flags.reached, truth)
    np.testing.assert_array_equal(new.reward, truth.astype(np.float32))
    assert truth.any()
    no_successor = rows._replace(flags=rows.flags._replace(no_successor=jnp.ones(4000, bool)))
    assert (method.relabel(jax.random.key(1), env, goals, no_successor).flags.goal == 0).all()


def test_vaprl_relabels_demonstrations_with_where_they_went(env):
    method, goals = make_algo("vaprl", relabel_share=1.0), goal_table(env)
    row = np.repeat(np.arange(100), 40)
    rows = rows_of(env, goals, goals.candidates[row], goals.candidates[row + 1], row, 0)
    later = np.asarray(method.relabel(jax.random.key(1), env, goals, rows).flags.goal) - 5
    assert (later > row).all()
    assert (later <= goals.ends[row]).all()
    assert len(set(later[row == 60].tolist())) > 20


def test_time_outs_are_terminal_unless_bootstrapped(env):
    goals = goal_table(env)
    rows = rows_of(env, goals, goals.candidates[:4], goals.candidates[1:5], np.arange(4), 0)
    flags = rows.flags._replace(reached=jnp.array([1, 0, 1, 0], bool), timeout=jnp.array([0, 1, 0, 0], bool))
    rows = rows._replace(flags=flags)
    np.testing.assert_array_equal(make_algo("naive").terminal(rows), [True, True, True, False])
    through = make_algo("naive", timeout_bootstrap=True).terminal(rows)
    np.testing.assert_array_equal(through, [True, False, True, False])
