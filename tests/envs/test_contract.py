"""The contract of an env, for every task of the registry."""

import dataclasses
import functools
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.envs import HelpBudget, list_envs, make, register_env
from tests.conftest import assert_all_finite, assert_equal_trees, take_lane

DEFAULT_REWARD = pytest.mark.parametrize(("name", "reward_type"), [(n, make(n).reward_type) for n in list_envs()])
"""The task's own kind of reward alone: for tests that cost a compilation and do not depend on the reward."""
EVERY_REWARD = pytest.mark.parametrize(
    ("name", "reward_type"), [(n, r) for n in list_envs() for r in ("sparse", "dense")]
)


def describe(tree):
    return jax.tree.map(lambda leaf: (leaf.shape, leaf.dtype, leaf.weak_type), jax.tree.map(jax.typeof, tree))


@functools.cache
def first_state(name, reward_type):
    """Return a state after a reset, by one program instead of one for every operation."""
    return jax.jit(make(name, reward_type=reward_type).reset)(jax.random.key(0))


@EVERY_REWARD
def test_state_keeps_structure_dtypes_and_weak_types(name, reward_type):
    env = make(name, reward_type=reward_type)
    state = first_state(name, reward_type)
    after = jax.jit(env.step)(state, jnp.zeros(env.action_size))
    assert describe(state) == describe(after)
    assert describe(state) == describe(env.with_goal(after, jnp.asarray(env.initial_states[0])))
    assert state.obs.shape == (env.obs_size,)
    assert state.obs.dtype == state.reward.dtype == state.done.dtype == jnp.float32


@pytest.mark.parametrize("name", ["dhand_lightbulb", "franka_kitchen", "minitaur_pen", "sawyer_door", "sawyer_peg"])
def test_the_papers_variant_keeps_structure_and_sizes(name):
    env = make(name, variant="paper")
    state = jax.eval_shape(env.reset, jax.random.key(0))
    after = jax.eval_shape(env.step, state, jax.ShapeDtypeStruct((env.action_size,), jnp.float32))
    shapes = [jax.tree.map(lambda leaf: (leaf.shape, leaf.dtype), tree) for tree in (state, after)]
    assert shapes[0] == shapes[1]
    assert state.obs.shape == (env.obs_size,)
    assert env.goal_states.shape[1:] == env.initial_states.shape[1:] == (env.goal_size,)


@DEFAULT_REWARD
def test_step_is_traced_once_and_scans(name, reward_type):
    env = make(name, reward_type=reward_type)
    traces = []

    @jax.jit
    def step(state, action):
        traces.append(1)
        return env.step(state, action)

    state = first_state(name, reward_type)
    for _ in range(3):
        state = step(state, jnp.ones(env.action_size))
    assert len(traces) == 1
    actions = jax.random.uniform(jax.random.key(1), (200, env.action_size), minval=-1, maxval=1)
    actions = actions.at[100:].set(jnp.sign(actions[100::10]).repeat(10, axis=0))  # saturated, and held for ten steps

    def scanned_step(state, action):
        state = env.step(state, action)
        return state, (state.reward, env.fault(state))

    final, (rewards, faults) = jax.lax.scan(scanned_step, state, actions)
    assert rewards.shape == (200,)
    assert not faults.any()
    assert_all_finite(final)


FAULTS = {
    "cheetah_run": [("qvel", 3, np.nan), ("qpos", 1, -1.5), ("qpos", 1, 11.0)],
    "dhand_lightbulb": [("obs", 0, np.nan), ("obs", 25, 0.6), ("obs", 23, 1.5), ("obs", 28, 2.0)],
    "fish_swim": [("qvel", 3, np.nan), ("obs", 2, 7.0)],
    "franka_kitchen": [
        *[("qpos", 0, np.nan), ("qpos", 6, 30.0), ("qpos", 17, 0.5), ("qpos", 14, 1.0), ("qpos", 9, -2.0)],
        ("obs", 3, np.inf),
    ],
    "minitaur_pen": [("qpos", 0, np.nan), ("qpos", 0, 5.0)],
    "sawyer_door": [("obs", 5, 2.0), ("obs", 2, -0.5)],
    "sawyer_peg": [("obs", 5, 2.0), ("obs", 2, -0.5)],
}
"""What makes a state of a task broken or impossible: a field, an index and its value. In others, a number that is none."""


@pytest.mark.parametrize("name", list_envs())
def test_a_broken_or_impossible_state_is_a_fault_and_irreversible(name):
    env, state = make(name), first_state(name, make(name).reward_type)
    assert not env.fault(state)
    assert not env.irreversible(state)
    for field, index, value in FAULTS.get(name, [("obs", 0, np.nan)]):
        owner = state if field == "obs" else state.data
        part = {field: getattr(owner, field).at[index].set(value)}
        broken = state.replace(**part) if field == "obs" else state.replace(data=state.data.replace(**part))
        assert env.fault(broken), (field, index)
        assert env.irreversible(broken), (field, index)


@DEFAULT_REWARD
def test_vmap_equals_a_loop(name, reward_type):
    env = make(name, reward_type=reward_type)
    keys = jax.random.split(jax.random.key(3), 4)
    actions = jax.random.uniform(jax.random.key(4), (4, env.action_size), minval=-1, maxval=1)

    def reset_and_step(key, action):
        return env.step(env.reset(key), action)

    batch, single = jax.jit(jax.vmap(reset_and_step))(keys, actions), jax.jit(reset_and_step)
    for lane in range(4):
        assert_equal_trees(take_lane(batch, lane), single(keys[lane], actions[lane]), rtol=1e-6, atol=1e-6)


@EVERY_REWARD
def test_a_goal_is_a_success_of_itself_and_every_goal_is_drawn(name, reward_type):
    env = make(name, reward_type=reward_type)
    assert env.goal_states.shape[1] == env.goal_size
    if env.goal_size == env.state_size:
        assert np.asarray(env.success(jnp.concatenate([env.goal_states, env.goal_states], axis=1))).all()
    state = first_state(name, reward_type)
    goal = jnp.asarray(env.goal_states[-1])
    np.testing.assert_array_equal(env.with_goal(state, goal).obs[env.state_size :], goal)
    count = max(200, 12 * len(env.goal_states))
    draws = jax.jit(jax.vmap(env.sample_goal))(jax.random.split(jax.random.key(5), count))
    assert {tuple(row) for row in np.asarray(draws).tolist()} == {tuple(row) for row in env.goal_states.tolist()}


@EVERY_REWARD
def test_an_env_is_a_hashable_constant(name, reward_type):
    env = make(name, reward_type=reward_type)
    assert hash(env) == hash(make(name, reward_type=reward_type))
    assert dataclasses.replace(env, eval_horizon=7).eval_horizon == 7
    assert reward_type in repr(env)


@EVERY_REWARD
@pytest.mark.parametrize("bad", ["shape", "nan", "inf"])
def test_bad_actions_are_refused(name, reward_type, bad):
    env = make(name, reward_type=reward_type)
    state = first_state(name, reward_type)
    action = np.zeros(env.action_size + (bad == "shape"), np.float32)
    action[-1] = {"shape": 0.0, "nan": np.nan, "inf": np.inf}[bad]
    with pytest.raises(ValueError, match="shape" if bad == "shape" else "not finite"):
        env.step(state, action)


def test_unknown_names_and_options_are_errors_that_list_the_choices():
    with pytest.raises(ValueError, match="tabletop_organization"):
        make("tabletop")
    with pytest.raises(ValueError, match=r"no option 'colour'.*reward_type"):
        make("tabletop_organization", colour="red")
    with pytest.raises(ValueError, match="sparse, dense"):
        make("tabletop_organization", reward_type="shaped")
    with pytest.raises(ValueError, match="exists already"):
        register_env("tabletop_organization", type(make("tabletop_organization")))


@pytest.mark.parametrize("name", list_envs())
def test_a_task_has_the_names_of_brax_and_gymnasium(name):
    env = make(name)
    assert (env.observation_size, env.dt, env.episode_length) == (env.obs_size, env.step_seconds, env.eval_horizon)
    assert env.observation_space.shape == (env.obs_size,)
    assert np.isinf(env.observation_space.high).all()
    assert env.action_space.shape == (env.action_size,)
    assert (env.action_space.low == -1).all()
    assert (env.action_space.high == 1).all()
    assert env.observation_space.dtype == env.action_space.dtype == np.float32


def test_the_names_belong_to_the_task_with_a_budget_too(env):
    helped = HelpBudget(task=env, budget=5.0)
    assert helped.observation_space.shape == (helped.observation_size,) == (env.obs_size + 1,)
    assert helped.action_space.shape == (env.action_size + 1,)


def test_spaces_without_gymnasium_are_a_clear_error(env, monkeypatch):
    monkeypatch.setitem(sys.modules, "gymnasium.spaces", None)
    with pytest.raises(ValueError, match="pip install gymnasium"):
        _ = env.action_space
    assert env.observation_size == 12
