"""Positions on a task's map, and uniform and wide starts: where they lie, and which tasks have them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax import assets
from earl_jax.envs import HelpBudget, balanced_starts, list_envs, make, start_of, tabletop
from earl_jax.envs.sawyer import door, peg as sawyer_peg
from tests.envs.programs import START_COUNT, first_state, program, starts

SPARSE = ["sawyer_door", "sawyer_peg", "tabletop_organization"]
PEG_OPTIONS = [{}, {"listed": True}, {"wide": True}, {"reset_at_goal": True}]
BODIES = {
    "dhand_lightbulb": lambda env, state: state.data.qpos[23:25],
    "fish_swim": lambda env, state: state.data.qpos[:2] + 0.0745 * state.obs[24:33].reshape(3, 3)[:2, 2],
    "minitaur_pen": lambda env, state: state.data.qpos[:2],
    "sawyer_door": lambda env, state: jnp.array(env.pose.hand[:2]),
    "sawyer_peg": lambda env, state: (state.data.qpos[9:12] + sawyer_peg.HEAD)[:2],
    "tabletop_organization": lambda env, state: state.data.qpos[:2],
}
"""The position of the body on the map of each task that has one."""


def nearest(positions, places):
    """Return the distance of each of `positions [n, 2]` to the nearest of `places [k, 2]`."""
    return np.linalg.norm(np.asarray(positions)[:, None] - places, axis=-1).min(axis=1)


@pytest.mark.parametrize("name", BODIES)
def test_the_map_position_is_that_of_the_body_and_lies_within_the_bounds(name):
    env = make(name)
    state = first_state(env)
    position = np.asarray(env.map.position(state.obs))
    np.testing.assert_allclose(position, BODIES[name](env, state), atol=1e-6)
    assert ((env.map.bounds[0] <= position) & (position <= env.map.bounds[1])).all()
    np.testing.assert_array_equal(env.map.position(np.stack([state.obs] * 2)), [position, position])


@pytest.mark.parametrize(
    ("name", "options"),
    [("tabletop_organization", {}), ("minitaur_pen", {}), *[("sawyer_peg", options) for options in PEG_OPTIONS]],
)
def test_starts_lie_near_the_listed_positions_of_the_map(name, options):
    env = make(name, **options)
    assert nearest(env.map.position(starts(env).obs), env.map.starts).max() < 0.03
    assert (env.map.bounds[0] <= env.map.goals).all()
    assert (env.map.goals <= env.map.bounds[1]).all()
    if env.goal_size == env.state_size:
        goals = np.asarray(env.map.position(jnp.asarray(np.tile(env.goal_states, 2))))
        assert nearest(goals, env.map.goals).max() < 1e-6


def test_tasks_without_a_map_uniform_or_wide_starts_say_so():
    for name in set(list_envs()) - set(BODIES):
        assert make(name).map is None
    assert make("tabletop_organization", wide=True).map.starts is None
    assert make("sawyer_door").map.goals is None
    with pytest.raises(ValueError, match="sawyer_peg has no uniform starts"):
        start_of(make("sawyer_peg"), "uniform")
    assert [name for name in list_envs() if make(name).starts.wide] == SPARSE
    assert all(make(name, reward_type="dense").starts.wide is None for name in SPARSE)
    with pytest.raises(ValueError, match="franka_kitchen has no wide starts"):
        start_of(make("franka_kitchen"), "wide")


def test_uniform_starts_cover_the_table_with_a_free_mug_and_every_goal(env):
    obs = np.asarray(starts(env, "starts.uniform").obs)
    counts = np.stack([np.histogram(column, 4, (-tabletop.LIMIT, tabletop.LIMIT))[0] for column in obs[:, :4].T])
    assert counts.sum() == 4 * START_COUNT
    assert (abs(counts - START_COUNT / 4) < 50).all()
    np.testing.assert_array_equal(obs[:, 4:6], -1)
    assert len(np.unique(obs[:, 6:], axis=0)) == 4
    np.testing.assert_array_equal(starts(env, "starts.uniform").data.qpos, obs[:, :4])


@pytest.mark.parametrize("name", SPARSE)
def test_hardly_a_wide_start_is_a_success_and_half_of_the_arms_lie_off_the_demonstrations(name):
    env = make(name)
    obs = starts(env, "starts.wide").obs
    assert np.asarray(program(env, "success")(obs)).mean() <= 0.002
    if name == "tabletop_organization":
        return
    demos = assets.demos(name, "forward")
    first = demos.states[np.append(True, demos.ends[:-1])]
    low, high = first[:, 4:7].min(axis=0) - 0.02, first[:, 4:7].max(axis=0) + 0.02
    far = ((obs[:, 4:7] < low) | (obs[:, 4:7] > high)).any(axis=1)
    assert 0.35 < far.mean() < 0.7


def test_the_door_is_anywhere_with_the_arm_at_rest_and_clear_of_it():
    env = make("sawyer_door")
    states = starts(env, "starts.wide")
    angles, hands = np.asarray(states.data.qpos[:, 9]), np.unique(np.asarray(states.obs[:, :3]).round(4), axis=0)
    assert angles.min() < -1.3
    assert -0.3 < angles.max() <= -door.NOISE + 1e-4
    assert len(hands) == 17, "the ordinary pose and sixteen others"
    away, above = np.linalg.norm(hands[:, :2] - door.HINGE, axis=1), hands[:, 2]
    assert ((away > 0.45) | (hands[:, 0] < -0.17) | (above > 0.3)).all()
    moved = jax.jit(jax.vmap(lambda state: env.step(state, jnp.array([0.0, 0.0, 0.0, -1.0]))))(states)
    resting = np.abs(np.asarray(states.data.qvel)).max(axis=1) == 0
    assert 0.4 < resting.mean() < 0.6
    np.testing.assert_allclose(moved.obs[resting, :7], states.obs[resting, :7], atol=1e-4)


PAIRS = {
    "franka_kitchen": ({"noise": False}, 6),
    "franka_kitchen of the text": ({"noise": False, "variant": "paper"}, 11),
    "franka_kitchen with a budget": ({"noise": False}, 6),
    "sawyer_peg": ({"listed": True}, 15),
    "tabletop_organization": ({}, 4),
}
"""Tasks with few pairs of start and goal: their options, and the number of pairs."""


@pytest.mark.parametrize("name", PAIRS)
def test_balanced_starts_have_every_pair_equally_often_and_the_rest_at_random(name):
    options, count = PAIRS[name]
    env = make(name.split()[0], **options)
    env = HelpBudget(env, 2.0) if "budget" in name else env
    pairs = {row.tobytes() for row in np.asarray(starts(env).obs).round(5)}
    assert len(pairs) == count

    def draw(seed):
        return balanced_starts(env, jax.random.key(seed), 2 * count + 1).obs

    rows = np.asarray(jax.jit(jax.vmap(draw))(jnp.arange(8))).round(5)
    often = [np.unique(lane, axis=0, return_counts=True) for lane in rows]
    assert all({row.tobytes() for row in unique} == pairs for unique, _ in often)
    assert all(sorted(counts) == [2] * (count - 1) + [3] for _, counts in often)
    assert len({lane[-1].tobytes() for lane in rows}) > 1, "the pair of the remainder differs"


def test_balanced_starts_of_a_task_with_one_pair_are_its_own():
    env = make("sawyer_door")
    keys = jax.random.split(jax.random.key(3), 4)
    own, balanced = jax.jit(lambda: (jax.vmap(env.reset)(keys), balanced_starts(env, jax.random.key(3), 4)))()
    np.testing.assert_array_equal(own.obs, balanced.obs)


@pytest.mark.parametrize("name", list_envs())
def test_starts_and_demonstrations_have_their_types_where_a_user_computes_in_float64(name):
    env, key = make(name), jax.random.key(0)
    state_at, expert = env.demonstrations.state_at, env.demonstrations.expert

    def types():
        starts = [start_of(env, kind)(key) for kind in ("uniform", "wide") if getattr(env.starts, kind)]
        shown = state_at and state_at(np.zeros(env.state_size, np.float32), env.goal_states[0])
        return starts, balanced_starts(env, key, 6), shown, shown and expert(shown.obs)

    expected, reset = jax.eval_shape(types), jax.eval_shape(env.reset, key)
    with jax.enable_x64(True):
        assert jax.eval_shape(types) == expected
    assert all(state == reset for state in expected[0])
    assert expected[1] == jax.eval_shape(jax.vmap(env.reset), jax.random.split(key, 6))
