"""A life under the protocol, on chains with their goal at 3: the rules, the goals, both scores, and the budget."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.envs import HelpBudget
from earl_jax.protocol import Deployment, Protocol, advance, evaluate, init, intervene, lifetime_scores, set_goal
from earl_jax.training import Problem
from tests.conftest import (
    advance as train_steps,
    assert_equal_trees,
    lane_rules,
    make_problem,
    make_train_state,
    tiny_method,
)
from tests.envs.chain import Chain

LEFT, RIGHT = -1.0, 1.0
KEYS = jax.random.split(jax.random.key(0), 3)


@dataclasses.dataclass(frozen=True)
class OneGoal(Chain):
    """A chain without any random draw, whose simulation breaks left of 0."""

    fragile: bool = True

    @property
    def goal_states(self):
        return np.array([[self.goal]], np.float32)


def live(env, protocol, actions, rules=None, attempt_steps=1000):
    """Return the lives [T, N] after each of `actions [T, N or 1, a]`, and the results, in one program."""

    @jax.jit
    def run(rules):
        def step(lives, action):
            lives, results = jax.vmap(lambda life, action: advance(env, life, action))(lives, action)
            return lives, (lives, results)

        lives = jax.vmap(lambda key: init(env, protocol, key, attempt_steps))(KEYS)
        lives = lives if rules is None else lives.replace(rules=rules)
        each = jnp.broadcast_to(jnp.asarray(actions, jnp.float32), (len(actions), len(KEYS), env.action_size))
        return jax.lax.scan(step, lives, each)[1]

    return jax.device_get(run(rules))


def test_a_life_is_the_same_program_where_a_user_computes_in_float64():
    env, protocol = Chain(), make_problem(Chain()).protocol

    def lived(key):
        life = advance(env, init(env, protocol, key), np.ones(env.action_size))[0]
        life = intervene(env, set_goal(env, life, env.sample_goal(key)))
        return evaluate(env, protocol, life, lambda obs: jnp.ones(env.action_size))

    expected = str(jax.make_jaxpr(lived)(KEYS[0]))
    with jax.enable_x64(True):
        assert str(jax.make_jaxpr(lived)(KEYS[0])) == expected


def test_a_life_is_that_of_naive_rl_in_the_training_loop():
    """Interventions every 7 steps, attempts of 5 steps, and goal changes every 4, one in each lane, and faults in all."""
    problem, method = make_problem(OneGoal()), tiny_method("naive", 3, episode_length=5)
    rules, steps = lane_rules([7, 0, 0], [0.0] * 3, [0, 0, 4]), 40
    state = train_steps(problem, method, make_train_state(problem, method, [0, 1, 2], rules=rules), steps, warmup=True)
    actions, states = state.replay.action[:steps], state.replay.state[1 : steps + 1]
    lives, results = live(problem.env, problem.protocol, actions, rules=rules, attempt_steps=5)
    np.testing.assert_array_equal(lives.obs[..., :1], states)
    ours, theirs = lives.counters, state.lanes.counters.replace(diagnostics={})
    assert_equal_trees(jax.tree.map(lambda leaf: leaf[-1], ours), theirs)
    assert (theirs.faults > 0).all()
    broken = results.end.fault[1:]
    np.testing.assert_array_equal(results.next_obs[1:][broken], lives.obs[:-1][broken])
    assert (theirs.reached > 0).all()
    assert results.end.timeout.sum() > theirs.interventions.sum()


def test_goals_change_at_the_end_of_an_attempt_or_by_schedule():
    rules = lane_rules([0, 9, 0], [0.0] * 3, [0, 0, 10])
    lives, results = live(
        Chain(cliff=9, goal=6), Protocol(0, 5), np.full((60, 1, 1), LEFT), rules=rules, attempt_steps=4
    )
    assert (results.next_obs[1:, :, 1] == lives.obs[:-1, :, 1]).all(), "a step is made under the goal before it"
    changes = results.next_obs[..., 1] != lives.obs[..., 1]
    assert changes.any(axis=0).all()
    assert not (changes[:, :2] & ~results.end.phase_ended[:, :2]).any()
    assert {10, 20, 30, 40, 50, 60} >= set(1 + np.flatnonzero(changes[:, 2]))
    assert (results.reward == (results.next_obs[..., 0] == results.next_obs[..., 1])).all()
    np.testing.assert_array_equal(results.success, results.reward == 1)


def test_a_goal_of_the_agents_own_stays_and_earns_nothing_until_the_environment_chooses_again_or_intervenes():
    """Two lives, deployment and continuing, that stay at 0, a goal of their own, for 12 steps with interventions."""
    env = OneGoal(fragile=False)

    @jax.jit
    @jax.vmap
    def run(key, rules):
        life = set_goal(env, init(env, Protocol(5, 5), key).replace(rules=rules), jnp.zeros(1))
        life, results = jax.lax.scan(lambda life, _: advance(env, life, jnp.full(1, LEFT)), life, length=12)
        return life, results, set_goal(env, life), intervene(env, life)

    lives, results, freed, reset = jax.device_get(run(KEYS[:2], lane_rules([5, 5], [0.0, 0.0], [0, 7])))
    np.testing.assert_array_equal(results.next_obs[..., 1], 0.0)
    np.testing.assert_array_equal(results.reward, 1.0)
    np.testing.assert_array_equal(lives.counters.interventions, 2)
    np.testing.assert_array_equal(lives.counters.window_reward, 0.0)
    np.testing.assert_array_equal(lives.counters.reached, 0)
    np.testing.assert_array_equal(lives.counters.phases.reached, [[0, 12], [0, 12]])
    for chosen, interventions in ((freed, 2), (reset, 3)):
        np.testing.assert_array_equal(chosen.obs[:, 1], 3.0)
        np.testing.assert_array_equal(chosen.counters.interventions, interventions)
        assert not chosen.goal_is_set.any()
        assert not np.array_equal(jax.random.key_data(chosen.key), jax.random.key_data(lives.key))


def test_the_goal_of_the_schedule_stays_at_an_intervention_and_when_the_choice_is_given_back():
    env = Chain()

    @jax.jit
    @jax.vmap
    def goals(key):
        life = init(env, Protocol(0, 5, goal_change=7), key)
        given_back = set_goal(env, set_goal(env, life, 1 + life.task_goal))
        return life.task_goal, given_back.obs[1:], intervene(env, life).obs[1:]

    first, *later = goals(jax.random.split(jax.random.key(1), 20))
    assert len(np.unique(first)) == 2
    for chosen in later:
        np.testing.assert_array_equal(chosen, first)


def test_both_scores_of_a_life_of_two_windows():
    env, protocol = OneGoal(fragile=False), Protocol(0, 4, eval_episodes=3)

    @jax.jit
    def run(key):
        def window(life, _):
            life, _ = jax.lax.scan(lambda life, _: advance(env, life, jnp.full(1, RIGHT)), life, length=4)
            return evaluate(env, protocol, life, lambda obs: jnp.full(1, jnp.where(obs[0] < 2, RIGHT, LEFT)))

        return jax.lax.scan(window, init(env, protocol, key), length=2)

    life, metrics = run(KEYS[0])
    np.testing.assert_array_equal(metrics["deployed/success"], 0.0)
    np.testing.assert_array_equal(metrics["continuing/reward"], [1 / 4, 1 / 8])
    np.testing.assert_array_equal(metrics["continuing/recent"], [1 / 4, 0.0])
    np.testing.assert_array_equal(metrics["continuing/forward_success"], [1.0, np.nan])
    np.testing.assert_array_equal(metrics["reached"], 1)
    assert not [name for name in metrics if name.startswith("help/")]
    assert int(life.evaluated_at) == int(life.step) == 8
    scores = lifetime_scores(np.array([4, 8]), metrics, "deployed/success")
    assert [float(score) for score in scores] == [0.0, 0.0, 1 / 8]


def test_attempts_that_the_agent_gives_up_count_without_their_goal():
    env, protocol = OneGoal(goal=1, fragile=False), Protocol(0, 4, eval_episodes=1)

    def step(life):
        return advance(env, life, jnp.full(1, LEFT))[0]

    @jax.jit
    def run(key):
        life = set_goal(env, init(env, protocol, key))  # no step yet, so no attempt
        life = set_goal(env, step(step(life)), jnp.full(1, 7.0))
        life = intervene(env, step(life))
        life = intervene(env, step(intervene(env, life)))
        life, result = advance(env, life, jnp.full(1, RIGHT))
        return life, result.success, evaluate(env, protocol, life, lambda obs: jnp.zeros(1))[1]

    life, reached, metrics = run(KEYS[0])
    assert reached
    assert life.counters.phases.ended.tolist() == [3, 1]
    assert life.counters.phases.reached.tolist() == [1, 0]
    assert metrics["continuing/forward_success"] == pytest.approx(1 / 3)
    assert metrics["continuing/back_success"] == 0


def test_a_spent_budget_ends_a_life_and_not_its_evaluation():
    env, help_ = HelpBudget(OneGoal(fragile=False), budget=2.0), np.array([LEFT, RIGHT])
    lives, results = live(env, Protocol(1, 4), np.broadcast_to(help_, (3, 1, 2)))
    np.testing.assert_array_equal(results.terminated[:, 0], [False, True, True])
    assert lives.counters.interventions[:, 0].tolist() == [1, 1, 1], "what has ended is not reset"
    assert lives.counters.phases.ended[:, 0, 0].tolist() == [1, 1, 1], "nor do attempts end in it"
    np.testing.assert_array_equal(lives.has_ended, results.terminated)
    ended = jax.tree.map(lambda leaf: leaf[-1, 0], lives)
    assert int(jax.jit(intervene, static_argnums=0)(env, ended).counters.interventions) == 1
    measure = jax.jit(lambda life: evaluate(env, Protocol(0, 4), life, lambda obs: jnp.array([RIGHT, RIGHT])))
    metrics = measure(ended)[1]
    expected = {"help/asked": 2, "help/enforced": 0, "help/budget": 0, "help/over": 1}
    expected |= {"deployed/success": 1, "deployed/return": 1}
    assert {name: metrics[name] for name in metrics if name.startswith(("help/", "deployed/"))} == expected


def test_a_life_of_a_name_or_a_setting_is_refused():
    for use in (lambda env, protocol: init(env, protocol, KEYS[0]), Problem):
        with pytest.raises(ValueError, match="the task must be an object of Env, not 'chain'"):
            use("chain", Protocol(0, 4))
        with pytest.raises(ValueError, match=r"the protocol must be an object of Protocol, not Deployment\("):
            use(Chain(), Deployment())


def test_a_jitted_step_can_donate_what_is_returned_outside_jit(env):
    chain, protocol, still = Chain(), Protocol(0, 4, eval_episodes=1), jnp.zeros(1)
    step = jax.jit(lambda life: advance(chain, life, still)[0], donate_argnums=0)
    life = init(chain, protocol, KEYS[0])
    for function in (intervene, set_goal, lambda env, life: evaluate(env, protocol, life, lambda obs: still)[0]):
        life = function(chain, step(life))
    assert step(life).step == 4
    jax.jit(env.step, donate_argnums=0)(env.reset(KEYS[0]), jnp.zeros(env.action_size))
    helped, goal = HelpBudget(Chain(), budget=2.0), jnp.ones(1)
    for state in (helped.reset(KEYS[0]), helped.with_goal(helped.reset(KEYS[0]), goal)):
        arrays = [goal, *jax.tree.leaves(state)]
        assert len(set(map(id, arrays))) == len(arrays), "an array that is there twice cannot be donated"


def test_an_attempt_has_a_step_and_a_goal_the_tasks_shape_the_type_of_a_state_and_finite_numbers():
    with pytest.raises(ValueError, match="attempt_steps must lie in"):
        init(Chain(), Protocol(0, 4), KEYS[0], attempt_steps=0)
    with pytest.raises(ValueError, match="the state of a life must be an object of ProtocolState, not State"):
        advance(Chain(), Chain().reset(KEYS[0]), jnp.zeros(1))
    life = init(Chain(), Protocol(0, 4), KEYS[0])
    for goal, message in (([0, 0], r"has shape \(2,\), this task takes \(1,\)"), ([1e300], "is not finite: ")):
        with pytest.raises(ValueError, match=f"goal {message}"):
            set_goal(Chain(), life, goal)
    assert set_goal(Chain(), life, np.array([2])).obs.tolist() == [0.0, 2.0]
    assert set_goal(Chain(), life, np.array([2])).env_state.info["goal"].dtype == np.float32


def test_balanced_pairs_take_the_chance_out_of_the_score_of_a_policy_if_the_protocol_balances_them(env):
    """The returns of doing nothing differ between the four goals; a balanced evaluation has each of them once."""
    dense = dataclasses.replace(env, reward_type="dense")

    def scores(pairs):
        deployed, still = Protocol(0, 2, eval_episodes=4, eval_pairs=pairs).deployed, jnp.zeros(env.action_size)
        keys = jax.random.split(jax.random.key(0), 12)
        return jax.vmap(lambda key: deployed(dense, lambda obs: still, key)["deployed/return"])(keys)

    random, balanced = np.asarray(jax.jit(lambda: [scores(pairs) for pairs in ("random", "balanced")])())
    assert np.ptp(balanced) < 1e-5 < 0.1 < np.ptp(random)
    assert abs(random.mean() - balanced.mean()) < np.ptp(random)
