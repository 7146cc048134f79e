"""Help, budgets, the absorbing end, and evaluation without help: on a chain with known answers, and on real tasks."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.adapters._session import Session
from earl_jax.envs import HelpBudget, chosen_engine, for_lanes, make, without_budget
from earl_jax.envs.help_budget import without_help
from earl_jax.protocol import Deployment, Protocol, deployed
from earl_jax.training.scan import run_steps
from earl_jax.training.state import Problem
from tests.conftest import assert_all_finite, assert_equal_trees, make_train_state, take_lane, tiny_method
from tests.envs.chain import Chain
from tests.envs.programs import run_alone

LEFT, RIGHT, HELP = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0]], np.float32)


def start_state(env, asked=0):
    """Return the start of `env` with the chain's goal, after so many requests for help."""
    state = env.with_goal(env.reset(jax.random.key(0)), jnp.asarray(env.goal_states[0]))
    left = jnp.asarray(env.budget - asked * env.help_cost, jnp.float32)
    return env._augmented(state.data, {**state.info, "asked": jnp.asarray(asked, jnp.int32), "budget": left})


def run_actions(env, actions, asked=0):
    """Return the states [T + 1] before and after every one of the `actions [T, a]`, from `start_state`."""
    first = jax.jit(start_state, static_argnums=0)(env, asked)
    rest = run_alone(env, first, actions)
    return jax.tree.map(lambda leaf, later: np.concatenate([np.asarray(leaf)[None], later]), first, rest)


@pytest.mark.parametrize(("budget", "cost", "last"), [(3.0, 1.0, 12), (2.5, 1.0, 12), (1.0, 0.25, 16), (1.0, 0.0, 99)])
def test_moving_right_falls_every_four_steps_until_an_intervention_exceeds_the_budget(budget, cost, last):
    env = HelpBudget(Chain(), budget=budget, enforced_cost=cost)
    states, time = run_actions(env, np.tile(RIGHT, (20, 1))), np.arange(21)
    falls, over = np.minimum(time, last) // 4, time >= last
    np.testing.assert_array_equal(states.info["enforced"], falls)
    np.testing.assert_array_equal(states.info["asked"], 0)
    np.testing.assert_array_equal(states.done, over)
    np.testing.assert_array_equal(states.info["budget"], np.where(over, 0.0, budget - cost * falls))
    np.testing.assert_array_equal(states.obs[:, 1], states.info["budget"] / budget)
    np.testing.assert_array_equal(states.obs[:, 0], np.where(over, 3, time % 4))
    np.testing.assert_array_equal(states.reward[1:], ((time % 4 == 3) & ~over)[1:])
    np.testing.assert_array_equal(states.metrics["success"], states.reward)


@pytest.mark.parametrize(("budget", "cost", "last"), [(6.3, 0.7, 9), (2.7, 0.9, 3), (9000.0, 0.9, 10_000)])
def test_an_exactly_spent_budget_ends_the_lifetime_in_float32_too(budget, cost, last):
    env = HelpBudget(Chain(), budget=budget, help_cost=cost)
    states = run_actions(env, np.tile(HELP, (3, 1)), asked=last - 2)
    assert states.done.tolist() == [0, 0, 1, 1]


def test_help_discards_the_move_and_has_its_own_cost_even_beside_the_cliff():
    env = HelpBudget(Chain(start=1), budget=5.0, help_cost=0.5, enforced_cost=2.0)
    states = run_actions(env, [HELP, RIGHT, RIGHT, HELP, RIGHT, RIGHT, RIGHT])
    np.testing.assert_array_equal(states.obs[:, 0], [1, 1, 2, 3, 1, 2, 3, 1])
    np.testing.assert_array_equal(states.info["budget"], [5, 4.5, 4.5, 4.5, 4, 4, 4, 2])
    assert (states.info["asked"][-1], states.info["enforced"][-1]) == (2, 1)
    for goals in (states.obs[:, 2:], states.info["goal"], states.data.info["goal"]):
        np.testing.assert_array_equal(goals, 3.0)


@pytest.mark.parametrize(("above", "requests"), [(0.98, [0, 0, 1]), (-1.0, [0, 1, 1])])
def test_only_a_last_component_above_the_threshold_requests_help(above, requests):
    env = HelpBudget(Chain(), budget=9.0, help_above=above)
    states = run_actions(env, np.float32([[1.0, -1.0], [1.0, 0.98], [1.0, 5.0]]))
    assert np.diff(states.info["asked"]).tolist() == requests


def test_every_intervention_draws_a_new_start_from_rho():
    env = HelpBudget(make("tabletop_organization", wide=True), budget=9.0)

    @jax.jit
    def starts(key):
        first = env.step(env.reset(key), jnp.array([0, 0, 0, 1.0]))
        return jnp.stack([first.obs, env.step(first, jnp.array([0, 0, 0, 1.0])).obs])

    first, same, other = (np.asarray(starts(jax.random.key(seed))) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, same)
    assert len({*first[:, 0].tolist(), *other[:1, 0].tolist()}) == 3


class Worn(Chain):
    """A chain that keeps its last action in each intervention and loses it in a reset."""

    def reset(self, key):
        return self._with_wear(super().reset(key), 0.0)

    def intervene(self, key, state):
        return self._with_wear(super().reset(key), state.info["wear"])

    def finish_step(self, state, pending):
        return self._with_wear(super().finish_step(state, pending), state.info["wear"] + 1.0)

    def _with_wear(self, state, wear):
        return state.replace(info={**state.info, "wear": jnp.asarray(wear)})


def test_help_keeps_what_survives_an_intervention_and_discards_the_step_in_which_it_was_asked_for():
    env = HelpBudget(Worn(), budget=5.0)
    states = run_actions(env, [RIGHT, HELP, RIGHT, RIGHT, HELP])
    assert states.data.info["wear"].tolist() == [0, 1, 1, 2, 3, 3]


def test_a_hard_intervention_costs_nothing_and_restores_nothing():
    env = HelpBudget(Chain(start=1), budget=5.0)
    intervene = jax.jit(lambda state: env.intervene(jax.random.key(3), state))
    states = run_actions(env, [HELP, RIGHT, HELP, HELP, HELP, HELP])
    before, ended = take_lane(states, 2), take_lane(states, 6)
    after = intervene(before)
    assert (after.obs[0], before.obs[0]) == (1, 2)
    assert (after.info["budget"], after.info["asked"], after.done) == (4, 1, 0)
    assert after.obs[1] == before.obs[1] == np.float32(0.8)
    assert ended.done == 1
    assert_equal_trees(intervene(ended), ended)


def test_the_absorbing_end_lasts_and_earns_the_absorbed_reward():
    env = HelpBudget(Chain(reward_type="dense"), budget=1.0, absorbed_reward=-7.0)
    states = run_actions(env, [RIGHT, HELP, LEFT, HELP, RIGHT])
    np.testing.assert_array_equal(states.reward[1:], [-2, -7, -7, -7, -7])
    first, *later = (take_lane(states, step) for step in (2, 3, 4, 5))
    for state in later:
        assert_equal_trees(state, first)
    assert first.obs.tolist() == [1, 0, 3]
    assert env.goal_reward(first, np.zeros(1, np.float32)) == env.reward(first.obs) == -7
    assert not HelpBudget(Chain(goal=1), budget=1.0).success(np.float32([1.0, 0.0, 1.0]))


def test_a_fault_is_an_enforced_intervention_after_which_the_state_is_finite():
    env = HelpBudget(Chain(fragile=True), budget=2.0)
    states = run_actions(env, [LEFT, RIGHT, LEFT, LEFT, LEFT])
    np.testing.assert_array_equal(states.info["enforced"], [0, 1, 1, 1, 2, 2])
    np.testing.assert_array_equal(states.done, [0, 0, 0, 0, 1, 1])
    assert_all_finite(states)
    assert not jax.vmap(env.fault)(states).any()
    broken = jax.jit(lambda: env.task.step(env.task.reset(jax.random.key(0)), jnp.array([-1.0])))()
    assert env.task.fault(broken)


def test_with_a_budget_a_simulated_task_moves_as_without():
    task = make("sawyer_peg", reward_type="dense")
    env, action = HelpBudget(task, 2.0), jnp.array([0.4, -0.9, 0.1, 0.6, -1.0])

    @jax.jit
    def both(key):
        start = env.reset(key)
        helped, inner = env.step(start, action), task.step(start.data, action[:-1])
        goal = inner.obs[: env.goal_size]
        rewards = env.goal_reward(helped, goal), task.goal_reward(inner, goal)
        return (helped.data, helped.reward, rewards[0]), (inner, inner.reward, rewards[1])

    assert_equal_trees(*both(jax.random.key(0)))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"budget": 0.0}, r"budget must lie in \(0, 1000000000\], not 0\.0"),
        ({"budget": np.inf}, "budget must be a finite number, not inf"),
        ({"budget": "5"}, "budget must be a finite number, not '5'"),
        ({"help_cost": -1.0}, "help_cost must lie in"),
        ({"enforced_cost": np.nan}, "enforced_cost must be a finite number"),
        ({"help_above": 1.0}, r"help_above must lie in \[-1, 1\)"),
        ({"absorbed_reward": -1.0}, "absorbed_reward must be 0 with a sparse reward"),
        ({"task": Chain(reward_type="dense"), "absorbed_reward": np.nan}, "absorbed_reward must be a finite number"),
        ({"task": HelpBudget(Chain(), 1.0)}, "without a budget of its own"),
        ({"task": "sawyer_peg"}, "the task must be an object of Env, not 'sawyer_peg'"),
    ],
)
def test_invalid_options_and_actions_of_the_tasks_own_size_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        HelpBudget(**{"task": Chain(), "budget": 1.0, **options})
    env = HelpBudget(Chain(), 1.0)
    with pytest.raises(ValueError, match=r"takes \(2,\)"):
        jax.eval_shape(lambda: env.step(start_state(env), jnp.zeros(1)))


def test_a_lane_learns_until_its_absorbing_end_and_then_stops_learning_and_storing():
    """Losses of the updates that it does not take used to stand in metrics.csv."""
    problem = Problem(HelpBudget(Chain(), budget=5.0, help_above=-1.0), Protocol(train_horizon=7, eval_horizon=5))
    method = tiny_method("naive")
    run = jax.jit(lambda state: run_steps(problem, method, state, 5))
    first = make_train_state(problem, method, [0, 1], steps=20)
    before = run(first)
    after = run(before)
    old, new = (jax.tree.leaves(state.lanes.agent.actor)[-1].reshape(2, -1) for state in (first, before))
    assert (old != new).any(axis=1).tolist() == [True, True]
    assert before.lanes.env_state.done.tolist() == [1, 1]
    assert before.replay.counts[:, 0].tolist() == after.replay.counts[:, 0].tolist() == [5, 5]
    kept = [
        (lanes.agent, lanes.env_state.info["asked"], lanes.env_state.data.data, lanes.counters.replace(phases=None))
        for lanes in (before.lanes, after.lanes)
    ]
    assert_equal_trees(*kept)


def test_the_wrapper_has_the_properties_of_its_task():
    task = make("tabletop_organization", train_horizon=77, eval_horizon=9)
    env = Deployment(budget=4.0).wrap(task)
    assert (env.name, env.state_size, env.goal_size, env.action_size) == (task.name, 7, 6, 4)
    assert (env.train_horizon, env.eval_horizon, env.sparse, env.has_absorbing_state) == (77, 9, True, True)
    assert chosen_engine(env) == "kinematic"
    assert (env.view.dt, env.map.unit) == (0.1, "table units")
    np.testing.assert_array_equal(env.goal_states, task.goal_states)

    def answers(key):
        state, wide = env.starts.uniform(key), env.starts.wide(key)
        task_obs = env.task_obs(state.obs)
        own = env.map.position(state.obs), env.demonstrations.expert(state.obs)
        return own, (task_obs[:2], task.demonstrations.expert(task_obs)), wide

    (position, action), (task_position, task_action), wide = jax.jit(answers)(jax.random.key(0))
    np.testing.assert_array_equal(position, task_position)
    np.testing.assert_array_equal(action, [*task_action, -1])
    assert (wide.obs.shape, float(wide.info["budget"])) == ((env.observation_size,), 4.0)
    wrapped_peg = for_lanes(HelpBudget(make("sawyer_peg"), budget=1.0), 2)
    assert wrapped_peg.task.engine == chosen_engine(wrapped_peg) == "c"
    assert wrapped_peg.continuing == (400, 50_000)


def test_demonstrations_have_a_full_budget_and_never_request_help():
    task = make("tabletop_organization")
    env = HelpBudget(task, budget=4.0)
    assert env.demonstrations.directions == task.demonstrations.directions == ("forward", "backward")
    for direction in env.demonstrations.directions:
        demos, task_demos = env.demonstrations.load(direction), task.demonstrations.load(direction)
        np.testing.assert_array_equal(demos.states, np.pad(task_demos.states, ((0, 0), (0, 1)), constant_values=1))
        np.testing.assert_array_equal(demos.next_states[:, 6], 1)
        np.testing.assert_array_equal(demos.actions, np.pad(task_demos.actions, ((0, 0), (0, 1)), constant_values=-1))
        assert demos.goals is task_demos.goals


def test_without_help_an_agent_falls_once_its_requests_move_like_other_actions_and_a_fault_stays_one():
    chain = Chain(start=1)
    helped = HelpBudget(chain, budget=2.0)
    assert without_budget(helped) is without_budget(chain) is without_help(chain) is chain
    env = without_help(helped)
    assert (env.observation_size, env.action_size) == (helped.observation_size, helped.action_size)
    states = run_actions(env, [HELP, RIGHT, HELP, RIGHT])
    assert states.obs[:, 0].tolist() == [1, 2, 3, 4, 4]
    assert states.obs[:, 1].tolist() == [1] * 5
    for unchanged in (states.done, states.info["asked"], states.info["enforced"]):
        assert not unchanged.any()
    score = jax.jit(lambda action: deployed(helped, lambda obs: action, jax.random.key(0), 4, 2))
    assert score(HELP) == score(RIGHT), "an evaluation of its own has no help either"
    env = without_help(HelpBudget(Chain(fragile=True), budget=2.0))
    assert env.fault(take_lane(run_actions(env, [LEFT]), 1))


def test_episodes_of_the_adapters_have_the_spaces_of_the_lifetime_and_no_help():
    setting = Deployment(budget=1.0)
    train, episodes = (Session.of(Chain(start=1), mode=mode, setting=setting) for mode in ("train", "eval"))
    sizes = [(session.env.observation_size, session.env.action_size) for session in (train, episodes)]
    assert sizes == [(3, 2), (3, 2)]
    _, result = episodes.step(episodes.start(np.uint32(0))[0], HELP)
    assert (float(result.obs[0]), float(result.obs[1]), bool(result.terminated)) == (2, 1, False)
    assert bool(train.step(train.start(np.uint32(0))[0], HELP)[1].terminated)
    assert train.protocol == episodes.protocol
