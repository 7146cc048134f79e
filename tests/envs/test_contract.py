"""The contract of an env, for every task of the registry; the numbers of the paper, faults and limits in tables by task."""

import dataclasses
import functools
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks.physics.minitaur_trots import loop_error
from earl_jax import physics
from earl_jax.envs import PAPER_TASKS, Env, HelpBudget, KinematicEnv, MujocoEnv, env_class, list_envs, make, with_engine
from earl_jax.envs.dhand.observation import TABLE
from earl_jax.errors import InputError, annotations
from tests.conftest import assert_all_finite, assert_equal_trees, to_numpy
from tests.envs.chain import Chain
from tests.envs.programs import first_state, program, starts

EVERY_TASK = pytest.mark.parametrize("name", list_envs())
VARIANTS = [make(name, variant="paper") for name in list_envs() if "variant" in env_class(name).__dataclass_fields__]
ENVS = [*[make(name, reward_type=reward) for name in list_envs() for reward in ("sparse", "dense")], *VARIANTS]
IN_FLOAT64 = [
    ("tabletop_organization", None),
    ("minitaur_pen", "c"),
    *[pytest.param(name, "c", marks=pytest.mark.slow) for name in PAPER_TASKS[1:-1]],
    pytest.param("sawyer_door", "mjx", marks=pytest.mark.slow),
]
HELPED = [HelpBudget(make(name, reward_type="dense"), 2.0) for name in ("tabletop_organization", "sawyer_peg")]
STEPS, LANES = 200, 4
NUMBERS = {
    "cheetah_run": (17, 0, 6, 100_000, 1000, 1000, None, "dense", 0.01, 1, 1),
    "dhand_lightbulb": (32, 3, 22, 400_000, 400, 400, None, "dense", 0.1, 1, 9),
    "fish_swim": (33, 3, 5, 100_000, 1000, 1000, None, "dense", 0.04, 405, 26),
    "franka_kitchen": (23, 23, 9, 100_000, 400, 800, 50_000, "dense", 0.08, 1, 6),
    "minitaur_pen": (30, 2, 8, 100_000, 1000, 2000, None, "dense", 0.01, 12, 1),
    "sawyer_door": (7, 7, 4, 200_000, 300, 600, 50_000, "sparse", 0.0125, 1, 1),
    "sawyer_peg": (7, 7, 4, 100_000, 200, 400, 50_000, "sparse", 0.0125, 1, 15),
    "tabletop_organization": (6, 6, 3, 200_000, 200, 400, 50_000, "sparse", 0.1, 4, 1),
}
"""Sizes of state, goal and action; H_T, H_E, the steps between goal changes, H_T of the released continuing setting; the reward;
seconds of a step; the numbers of goals and of initial states."""


def peg_at(x, y):
    """Return the change of a state that puts the middle of the peg at `x, y`."""
    return {("obs", 4): x - 0.1, ("obs", 5): y}


def tilted(degrees, axis):
    """Return the change of a state that turns the robot by `degrees` about `axis`."""
    half = np.deg2rad(degrees) / 2
    quat = [*(np.sin(half) * np.eye(3)[axis]), np.cos(half)]
    return {("obs", 24 + part): number for part, number in enumerate(quat)}


FAULTS = {
    "cheetah_run": [{("qvel", 3): np.nan}, {("qpos", 1): -1.5}, {("qpos", 1): 11.0}],
    "dhand_lightbulb": [{("obs", 0): np.nan}, {("obs", 25): 0.6}, {("obs", 23): 1.5}, {("obs", 28): 2.0}],
    "fish_swim": [{("qvel", 3): np.nan}, {("obs", 2): 7.0}],
    "franka_kitchen": [
        *[{("qpos", joint): value} for joint, value in ((0, np.nan), (6, 30.0), (17, 0.5), (14, 1.0), (9, -2.0))],
        {("obs", 3): np.inf},
    ],
    "minitaur_pen": [{("qpos", 0): np.nan}, {("qpos", 0): 5.0}],
    "sawyer_door": [{("obs", 5): 2.0}, {("obs", 2): -0.5}],
    "sawyer_peg": [{("obs", 5): 2.0}, {("obs", 2): -0.5}, peg_at(0.0, 1.01), peg_at(0.71, 0.6), peg_at(0.0, 0.19)],
}
"""Changes, by field and index, that break a state of a task or make it impossible. In others, a number that is none."""
IRREVERSIBLE = {
    "dhand_lightbulb": [{("obs", 23): 0.31}],
    "minitaur_pen": [tilted(degrees, axis) for degrees in (121, 180, -150) for axis in (0, 1)],
    "sawyer_peg": [peg_at(0.1, 0.33), peg_at(0.69, 0.6), peg_at(-0.69, 0.6)],
}
"""Changes after which the agent cannot go on, although nothing is broken."""
REVERSIBLE = {
    "dhand_lightbulb": [{("obs", 23): 0.33}, {("obs", 23): 0.31, ("qvel", 24): 0.2}, {("obs", 23): 1.1}],
    "minitaur_pen": [tilted(degrees, axis) for degrees in (0, 95, 119) for axis in (0, 1)],
    "sawyer_peg": [peg_at(0.1, 0.34), peg_at(0.67, 0.6), peg_at(-0.67, 0.6), peg_at(0.0, 0.99)],
}
"""Changes near those, after which it can."""


def joints_beyond_limits(states):
    low, high = physics.load_model("franka_kitchen").jnt_range.T
    return np.maximum(low - states.data.qpos, states.data.qpos - high).max(axis=(0, 1))


KEPT = {
    "dhand_lightbulb": lambda states: states.obs[..., 25].min() > TABLE,
    "franka_kitchen": lambda states: (joints_beyond_limits(states)[7:] < np.repeat([0.005, 0.05], [2, 9])).all(),
    "minitaur_pen": lambda states: loop_error(states.data.qpos[::40]) < 1e-3,
}
"""What long random use must not violate, although it is no fault: the bulb's height, joint limits, closed legs."""


def test_the_goals_of_a_class_cannot_be_changed_for_all_its_tasks():
    goals = make("tabletop_organization").goal_states
    with pytest.raises(ValueError, match="read-only"):
        goals[0] = 0


@pytest.mark.parametrize("env", [*ENVS, *HELPED], ids=lambda env: env.name)
def test_a_state_keeps_its_structure_and_an_env_is_a_hashable_constant(env):
    def states(key, action, goal):
        state = env.reset(key)
        after = env.step(state, action)
        wide = [env.starts.wide(key)] if env.starts.wide else []
        return state, after, env.with_goal(after, goal), env.intervene(key, after), *wide

    example = jnp.zeros(env.action_size), jnp.asarray(env.initial_states[0])
    trees = jax.eval_shape(states, jax.random.key(0), *example)
    assert jax.eval_shape(env.reset, jax.random.key(0, impl="rbg")) == trees[0]
    described = [jax.tree.map(lambda leaf: (leaf.shape, leaf.dtype, leaf.weak_type), tree) for tree in trees]
    assert all(other == described[0] for other in described)
    state = trees[0]
    assert state.obs.shape == (env.observation_size,)
    assert state.obs.dtype == state.reward.dtype == state.done.dtype == jnp.float32
    assert env.goal_states.shape[1:] == env.initial_states.shape[1:] == (env.goal_size,)
    same = dataclasses.replace(env)
    other = dataclasses.replace(env, **{"budget" if env in HELPED else "eval_horizon": 7})
    assert hash(env) == hash(same) != hash(other)
    assert repr(env) == repr(same) != repr(other)


@pytest.mark.parametrize(("name", "engine"), IN_FLOAT64)
def test_reset_and_step_are_the_same_program_where_a_user_computes_in_float64(name, engine):
    env = with_engine(make(name), engine)

    def moved(key):
        return env.step(env.with_goal(env.reset(key), np.ones(env.goal_size)), np.zeros(env.action_size))

    def traced():
        return str(jax.make_jaxpr(moved)(jax.random.key(0)))

    expected = traced()
    with jax.enable_x64(True):
        assert traced() == expected


@pytest.mark.parametrize(
    "env",
    [
        make("tabletop_organization"),
        make("sawyer_door"),
        make("sawyer_peg", listed=True),
        make("franka_kitchen"),
        HELPED[0],
    ],
    ids=lambda env: type(env).__name__,
)
def test_other_starts_are_of_the_same_types_where_a_user_computes_in_float64(env):
    number = {"numbered": [0]}
    calls = [
        functools.partial(start, jax.random.key(0), *number.get(name, []))
        for name, start in env.starts.functions.items()
    ]
    expected = [jax.eval_shape(call) for call in calls]
    assert expected
    with jax.enable_x64(True):
        assert [jax.eval_shape(call) for call in calls] == expected


@pytest.mark.parametrize("name", NUMBERS)
def test_the_numbers_of_a_task_are_the_papers_or_the_releases(name):
    env = make(name)
    sizes = env.state_size, env.goal_size, env.action_size
    horizons = env.train_horizon, env.eval_horizon, *env.continuing
    counts = len(env.goal_states), len(env.initial_states)
    assert (*sizes, *horizons, env.reward_type, env.view.dt, *counts) == NUMBERS[name]


@EVERY_TASK
def test_lanes_step_like_one_alone_and_no_action_breaks_a_task_but_one_that_is_not_finite(name):
    """Two lanes act at random, and two hold corners of the space of actions for ten steps each, until one acts with NaN."""
    env = make(name)
    keys = jax.random.split(jax.random.key(1), LANES)
    drawn = np.random.default_rng(0).uniform(-1, 1, (STEPS, LANES, env.action_size)).astype(np.float32)
    actions = np.where(np.arange(LANES)[:, None] < 2, drawn, np.sign(drawn[::10]).repeat(10, axis=0))
    actions[-1, 0, 0] = np.nan

    @jax.jit
    def live(keys, actions):
        def step(states, action):
            states = jax.vmap(env.step)(states, action)
            return states, (states, jax.vmap(env.fault)(states))

        return jax.lax.scan(step, jax.vmap(env.reset)(keys), actions)[1]

    states, faults = live(keys, actions)
    alone = program(env, "step")(program(env, "reset")(keys[-1]), actions[0, -1])
    assert_equal_trees(jax.tree.map(lambda leaf: to_numpy(leaf)[0, -1], states), alone, rtol=1e-6, atol=1e-6)
    assert not faults[:-1].any()
    assert faults[-1].tolist() == [True, False, False, False]
    states = jax.tree.map(lambda leaf: leaf[:-1], jax.device_get(states))
    assert_all_finite(states)
    assert KEPT.get(name, lambda states: True)(states)


def changed(state, changes):
    """Return `state` with `changes`: values by a field of the state or of its data, and an index."""
    for (field, index), value in changes.items():
        owner = state if field == "obs" else state.data
        array = np.array(getattr(owner, field))
        array[index] = value
        owner = owner.replace(**{field: array})
        state = owner if field == "obs" else state.replace(data=owner)
    return state


@EVERY_TASK
@pytest.mark.parametrize("function", ["success", "reward"])
def test_a_state_without_its_goal_is_refused(name, function):
    env = make(name)
    obs = jnp.zeros((3, env.observation_size))
    assert jax.eval_shape(getattr(env, function), obs).shape == (3,)
    for wrong in (obs[:, :-1], jnp.zeros(env.observation_size + 1), jnp.zeros(())):
        with pytest.raises(
            InputError, match=rf"{function} takes obs \[..., {env.observation_size}\], a state with its goal"
        ):
            getattr(env, function)(wrong)


@EVERY_TASK
def test_broken_and_impossible_states_are_faults_and_those_out_of_reach_irreversible_but_no_start(name):
    env = make(name)
    free, lost = [{}, *REVERSIBLE.get(name, [])], IRREVERSIBLE.get(name, [])
    broken = FAULTS.get(name, [{("obs", 0): np.nan}])
    states = [changed(first_state(env), changes) for changes in (*free, *lost, *broken)]
    answers = jax.jit(lambda states: [jnp.stack([env.fault(s), env.irreversible(s)]) for s in states])(states)
    expected = [[False, False]] * len(free) + [[False, True]] * len(lost) + [[True, True]] * len(broken)
    assert [answer.tolist() for answer in answers] == expected
    assert not jax.jit(jax.vmap(env.irreversible))(starts(env)).any()


@EVERY_TASK
def test_a_goal_is_a_success_of_itself_and_every_goal_is_drawn(name):
    env = make(name)
    goals = env.goal_states
    if env.goal_size == env.state_size:
        assert program(env, "success")(np.concatenate([goals, goals], axis=1)).all()
    moved = program(env, "with_goal")(first_state(env), goals[-1])
    np.testing.assert_array_equal(moved.obs[env.state_size :], goals[-1])
    keys = jax.random.split(jax.random.key(5), max(200, 12 * len(goals)))
    draws = jax.jit(jax.vmap(env.sample_goal))(keys)
    assert {tuple(row) for row in np.asarray(draws).tolist()} == {tuple(row) for row in goals.tolist()}


@EVERY_TASK
def test_a_task_has_the_spaces_of_gymnasium_and_refuses_bad_actions(name):
    env = make(name)
    spaces = (env.observation_space, env.observation_size, np.inf), (env.action_space, env.action_size, 1.0)
    for space, size, bound in spaces:
        assert (space.shape, space.dtype) == ((size,), np.float32)
        assert (space.high == bound).all()
        assert (space.low == -bound).all()
    for bad, size, message in ((0.0, 1, "shape"), (np.nan, 0, "not finite"), (np.inf, 0, "not finite")):
        action = np.zeros(env.action_size + size, np.float32)
        action[-1] = bad
        with pytest.raises(ValueError, match=message):
            env.step(first_state(env), action)
    with pytest.raises(InputError, match="step takes the State that reset or step returned"):
        env.step(first_state(env).obs, np.zeros(env.action_size, np.float32))


def test_actions_and_goals_can_be_lists(env):
    """jax warned that it will refuse them."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        moved = env.step(first_state(env), [0.0] * env.action_size)
        goal = env.goal_states[1].tolist()
        np.testing.assert_array_equal(env.with_goal(moved, goal).info["goal"], env.goal_states[1])


@pytest.mark.parametrize(
    ("cls", "count", "written"),
    [
        (Env, 35, {"start_step", "finish_step"}),
        (KinematicEnv, 36, {"transition"}),
        (MujocoEnv, 43, {"control", "observe"}),
    ],
)
def test_the_members_of_a_task_are_few_and_those_to_write_fewer(cls, count, written):
    names = {name for base in cls.__mro__ for name in (*vars(base), *annotations(base))}
    assert sum(not name.startswith("_") for name in names) <= count
    every_task = {"state_size", "action_size", "goal_states", "initial_states", "reset", "success", "reward"}
    assert cls.__abstractmethods__ == every_task | written


def test_literals_of_a_base_stay_choices():
    dense = dataclasses.make_dataclass("Dense", [("reward_type", str, "dense")], bases=(Chain,), frozen=True)
    with pytest.raises(ValueError, match="reward_type 'other' is not one of sparse, dense"):
        dense(reward_type="other")
