"""Positions on a task's map, uniform starts, and irreversible states."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.envs import list_envs, make, tabletop
from earl_jax.envs.dhand import lightbulb as dhand_lightbulb
from earl_jax.envs.sawyer import peg as sawyer_peg

MAPPED = ["dhand_lightbulb", "fish_swim", "minitaur_pen", "sawyer_door", "sawyer_peg", "tabletop_organization"]
WITH_IRREVERSIBLE_STATES = ["dhand_lightbulb", "minitaur_pen", "sawyer_peg"]
KEY = jax.random.key(0)


@functools.cache
def reset_task(name):
    """Return the task `name` and its first state."""
    env = make(name)
    return env, jax.jit(env.reset)(KEY)


@pytest.mark.parametrize("name", MAPPED)
def test_the_map_position_is_that_of_the_body_and_lies_within_the_bounds(name):
    env, state = reset_task(name)
    data = state.data.qpos
    expected = {
        "dhand_lightbulb": lambda: data[23:25],
        "fish_swim": lambda: data[:2] + 0.0745 * state.obs[24:33].reshape(3, 3)[:2, 2],
        "minitaur_pen": lambda: data[:2],
        "sawyer_door": lambda: jnp.array(env.pose.hand[:2]),
        "sawyer_peg": lambda: (data[9:12] + sawyer_peg.HEAD)[:2],
        "tabletop_organization": lambda: data[:2],
    }[name]()
    position = env.map_position(state.obs)
    np.testing.assert_allclose(position, expected, atol=1e-6)
    assert ((env.map_bounds[0] <= position) & (position <= env.map_bounds[1])).all()
    np.testing.assert_array_equal(env.map_position(jnp.stack([state.obs] * 2)), [position, position])


def test_the_papers_variant_of_the_peg_has_the_same_map_position():
    released, paper = (make("sawyer_peg", variant=variant) for variant in ("released", "paper"))
    np.testing.assert_array_equal(
        released.map_position(released.reset(KEY).obs), paper.map_position(paper.reset(KEY).obs)
    )
    assert not paper.irreversible(paper.reset(KEY))


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("tabletop_organization", {}),
        ("minitaur_pen", {}),
        *[("sawyer_peg", options) for options in ({}, {"listed": True}, {"wide": True}, {"reset_at_goal": True})],
    ],
)
def test_starts_lie_near_the_listed_positions_of_the_map(name, options):
    env = make(name, **options)
    positions = env.map_position(jax.jit(jax.vmap(env.reset))(jax.random.split(KEY, 100)).obs)
    distances = np.linalg.norm(np.asarray(positions)[:, None] - env.map_starts, axis=-1).min(axis=1)
    assert distances.max() < 0.03
    assert (env.map_bounds[0] <= env.map_goals).all()
    assert (env.map_goals <= env.map_bounds[1]).all()


def test_goals_lie_at_the_listed_positions_of_the_map():
    for name in ("tabletop_organization", "sawyer_peg"):
        env = make(name)
        reached = np.concatenate([env.goal_states, env.goal_states], axis=1)
        positions = np.asarray(env.map_position(jnp.asarray(reached)))
        assert np.linalg.norm(positions[:, None] - env.map_goals, axis=-1).min(axis=1).max() < 1e-6
    assert make("tabletop_organization", wide=True).map_starts is None
    assert make("sawyer_door").map_goals is None


def test_a_task_without_a_map_or_uniform_starts_is_an_error():
    for name in set(list_envs()) - set(MAPPED):
        assert make(name).map_bounds is None
        with pytest.raises(ValueError, match=f"{name} has no map"):
            make(name).map_position(jnp.zeros(46))
    with pytest.raises(ValueError, match="sawyer_peg has no uniform distribution"):
        make("sawyer_peg").reset_uniform(KEY)


def test_the_released_continuing_horizons():
    horizons = {name: make(name).continuing_horizon for name in list_envs()}
    released = ["franka_kitchen", "sawyer_door", "sawyer_peg", "tabletop_organization"]
    assert horizons == {**dict.fromkeys(list_envs()), **dict.fromkeys(released, 50_000)}


def test_uniform_starts_cover_the_table_with_a_free_mug_and_every_goal():
    env = make("tabletop_organization")
    obs = np.asarray(jax.jit(jax.vmap(env.reset_uniform))(jax.random.split(KEY, 4000)).obs)
    counts = np.stack([np.histogram(column, 4, (-tabletop.LIMIT, tabletop.LIMIT))[0] for column in obs[:, :4].T])
    assert counts.sum() == 16_000
    assert (abs(counts - 1000) < 120).all()
    np.testing.assert_array_equal(obs[:, 4:6], -1)
    assert len(np.unique(obs[:, 6:], axis=0)) == 4
    state = env.reset_uniform(KEY)
    np.testing.assert_array_equal(state.data.qpos, state.obs[:4])
    assert jax.tree.structure(state) == jax.tree.structure(env.reset(KEY))


@pytest.mark.parametrize(
    ("name", "options"),
    [
        *[(name, {}) for name in WITH_IRREVERSIBLE_STATES],
        ("sawyer_peg", {"wide": True}),
        ("sawyer_peg", {"reset_at_goal": True}),
    ],
)
def test_no_start_is_irreversible(name, options):
    env = make(name, **options)
    keys = jax.random.split(KEY, 500)
    assert not jax.jit(jax.vmap(lambda key: env.irreversible(env.reset(key))))(keys).any()


def peg_state(env, x, y):
    middle = jnp.array([x, y, 0.02], jnp.float32)
    goal = jnp.asarray(env.goal_states[0])
    return env.start_at(middle, middle + sawyer_peg.HEAD, goal, start=middle, grasp=jnp.zeros(()))


@pytest.mark.parametrize(
    ("x", "y", "irreversible", "fault"),
    [
        (0.1, 0.34, False, False),
        (0.1, 0.33, True, False),
        (0.63, 0.6, False, False),
        (0.65, 0.6, True, False),
        (-0.63, 0.6, False, False),
        (-0.65, 0.6, True, False),
        (0.0, 0.99, False, False),
        (0.0, 1.01, True, True),
        (0.71, 0.6, True, True),
        (0.0, 0.19, True, True),
    ],
)
def test_a_peg_is_irreversible_out_of_reach_and_a_fault_off_the_table(x, y, irreversible, fault):
    env = make("sawyer_peg")
    state = peg_state(env, x, y)
    assert (bool(env.irreversible(state)), bool(env.fault(state))) == (irreversible, fault)


@pytest.mark.parametrize(
    ("degrees", "irreversible"), [(0, False), (95, False), (119, False), (121, True), (180, True), (-150, True)]
)
@pytest.mark.parametrize("axis", [1, 2])
def test_a_minitaur_on_its_back_is_irreversible(degrees, irreversible, axis):
    env, state = reset_task("minitaur_pen")
    half = np.deg2rad(degrees) / 2
    quat = np.zeros(4, np.float32)
    quat[3], quat[axis - 1] = np.cos(half), np.sin(half)
    lying = state.replace(obs=state.obs.at[24:28].set(quat))
    assert bool(env.irreversible(lying)) == irreversible
    assert not env.fault(lying)


@pytest.mark.parametrize(
    ("x", "speed", "irreversible"), [(0.31, 0.0, True), (0.33, 0.0, False), (0.31, 0.2, False), (1.1, 0.0, False)]
)
def test_a_bulb_at_rest_out_of_reach_is_irreversible(x, speed, irreversible):
    env = make("dhand_lightbulb")
    state = env.start_at(jnp.array([x, 0.15]))
    state = state.replace(data=state.data.replace(qvel=state.data.qvel.at[24].set(speed)))
    assert bool(env.irreversible(state)) == irreversible
    assert not env.fault(state)
    below = state.replace(obs=state.obs.at[25].set(dhand_lightbulb.TABLE - 0.1))
    assert env.irreversible(below)
