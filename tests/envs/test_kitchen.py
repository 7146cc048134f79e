"""Kitchen: observation, noise and reward against NumPy, the released reset, scripts, limits, faults, the motion of the arm."""

import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from benchmarks.physics import kitchen as benchmark
from earl_jax import physics
from earl_jax.envs import make
from earl_jax.envs.kitchen import reward as kitchen_reward
from earl_jax.envs.kitchen.franka_kitchen import (
    ARM_QPOS,
    ARM_QVEL,
    ARM_WARMSTART,
    CLOSED,
    MIDDLE,
    NOISE,
    PAIRS,
    TEXT_GOALS,
)
from tests.conftest import take_lane

RELEASED_START = np.array(
    [0.148388023, -1.76848573, 1.84390296, -2.4768576, 0.260252026, 0.712533105, 1.59515394, 0.0479267505, 0.0371350919]
)
"""The released `init_qpos` of arm and fingers."""
MODEL = physics.load_model("franka_kitchen")


@pytest.fixture(scope="module")
def env():
    return make("franka_kitchen", engine="c")


def reward_in_numpy(obs, mocap, sites):
    """Return the released reward, component by component."""
    obs = np.asarray(obs, np.float64)
    total = -10 * np.linalg.norm(obs[9:23] - obs[32:46])
    parts = [[9, 10], [11, 12], [13, 14], [15, 16], [17, 18], [19], [20, 21], [22]]
    reaching = False
    for part, site in zip(parts, sites, strict=True):
        if np.linalg.norm(obs[part] - obs[np.array(part) + 23]) < 0.01 * len(part):
            total += 1
        elif not reaching:
            reaching = True
            total -= 0.5 * np.linalg.norm(np.asarray(mocap, np.float64) - site)
    return total


def test_numbers_as_released(env):
    assert (env.obs_size, env.state_size, env.goal_size, env.action_size) == (46, 23, 23, 9)
    assert (env.reward_type, env.train_horizon, env.eval_horizon, env.goal_change) == ("dense", 100_000, 400, 800)
    assert (env.goal_states.shape, env.initial_states.shape) == ((1, 23), (6, 23))
    assert env.simulator.timestep == pytest.approx(0.08 / 12)
    changed = {tuple(np.flatnonzero(row != CLOSED).tolist()) for row in env.initial_states}
    indices = {"micro": (22,), "hinge": (20, 21), "slide": (19,), "light": (17, 18)}
    assert changed == {tuple(sorted(indices[first] + indices[second])) for first, second in PAIRS}
    with pytest.raises(ValueError, match="released, paper"):
        make("franka_kitchen", variant="other")


def test_reset_is_the_state_after_ten_released_steps_of_no_action(env):
    model = physics.load_model("franka_kitchen", 0.002)
    joints = np.asarray(jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(1), 200)).data.qpos[:, 9:])
    for lane in range(6):
        data = mujoco.MjData(model)
        data.qpos[:9] = np.clip(RELEASED_START, model.jnt_range[:9, 0], model.jnt_range[:9, 1])
        data.qpos[9:] = env.initial_states[lane, kitchen_reward.FIRST[9:]]
        data.mocap_pos[0], data.ctrl[:] = MIDDLE, RELEASED_START[:2]
        mujoco.mj_step(model, data, 400)
        np.testing.assert_allclose(data.qpos[:9], ARM_QPOS, atol=1e-7)
        np.testing.assert_allclose(data.qvel[:9], ARM_QVEL, atol=1e-6)
        np.testing.assert_allclose(data.qacc_warmstart[:9], ARM_WARMSTART, atol=1e-5)
        assert np.abs(joints - data.qpos[9:]).max(axis=1).min() < 1e-6, "some start is this one"
    assert np.abs(np.array(ARM_QPOS[:7]) - CLOSED[:7]).max() < 0.03, (
        "the arm of the published goal, except for its noise"
    )


def test_noise_is_bounded_in_every_number_and_new_at_every_step(env):
    exact = dataclasses.replace(env, noise=False)

    def observe_twice(env, key):
        state = env.reset(key)
        after = env.step(state, jnp.zeros(9))
        return jnp.stack([state.obs, after.obs]), jnp.stack([state.data.qpos, after.data.qpos])

    keys = jax.random.split(jax.random.key(2), 400)
    noisy, joints = jax.jit(jax.vmap(lambda key: observe_twice(env, key)))(keys)
    noise = np.asarray(noisy[..., :23]) - kitchen_reward.observed(np.asarray(joints))
    assert (np.abs(noise) <= NOISE + 1e-6).all()
    np.testing.assert_allclose(np.abs(noise).max(axis=(0, 1)), NOISE, rtol=0.03, atol=1e-6)
    assert np.abs(np.corrcoef(noise[:, 0, 0], noise[:, 1, 0])[0, 1]) < 0.2
    without, joints = jax.jit(lambda key: observe_twice(exact, key))(keys[0])
    np.testing.assert_array_equal(without[:, :23], kitchen_reward.observed(np.asarray(joints)))
    expected = [*[0.01] * 9, *[0.0005] * 2, *[0.00005] * 6, *[0.0005] * 3, *[0.01] * 3]
    np.testing.assert_allclose(NOISE, expected, rtol=1e-6)


def test_observation_and_reward_match_numpy(env):
    """Plates and light block follow their joints, sites are those of the last substep, mocap is as commanded."""

    def step(state, action):
        state = env.step(state, action)
        return state, (state, env.goal_reward(state, state.obs[:23]))

    actions = jnp.asarray(np.sign(np.random.default_rng(0).uniform(-1, 1, (6, 9))).repeat(10, axis=0), jnp.float32)
    _, (states, own) = jax.jit(lambda a: jax.lax.scan(step, env.reset(jax.random.key(4)), a))(actions)
    joints = np.asarray(states.data.qpos, np.float64)
    plain = np.concatenate(
        [joints[:, :9], *[joints[:, [9 + k]] / [1, 174] for k in range(4)], joints[:, [13]] / [1, 14], joints[:, 14:]],
        axis=1,
    )
    assert (np.abs(states.obs[:, :23] - plain) <= NOISE + 1e-5).all()
    np.testing.assert_array_equal(states.obs[:, 23:], np.tile(CLOSED, (60, 1)))
    expected = np.array(MIDDLE)
    for move, mocap in zip(np.asarray(actions)[:, :3], states.info["mocap"], strict=True):
        expected = np.clip(expected + 0.02 * move, [-0.7, -0.1, 1.8], [0.4, 0.5, 2.6])
        np.testing.assert_allclose(mocap, expected, atol=1e-5)
    for obs, reward, mocap, sites in zip(
        states.obs, states.reward, states.info["mocap"], states.info["sites"], strict=True
    ):
        assert float(reward) == pytest.approx(reward_in_numpy(obs, mocap, sites), abs=1e-5)
    np.testing.assert_allclose(own, 8.0, atol=1e-5, err_msg="with its own state as goal, all eight parts are done")
    last = physics.mujoco_data(env.name, take_lane(states.data, -1)).site_xpos
    order = [MODEL.site(name).id for name in kitchen_reward.SITES]
    np.testing.assert_allclose(states.info["sites"][-1], last[order], atol=0.01)


def test_hand_and_handle_positions_from_joints_are_those_of_mujoco(env):
    rng, data = np.random.default_rng(0), mujoco.MjData(MODEL)
    flange = MODEL.eq_data[MODEL.equality("drag").id, 3:6]
    for _ in range(5):
        data.qpos[:] = rng.uniform(*MODEL.jnt_range.T)
        mujoco.mj_forward(MODEL, data)
        state = jnp.asarray(kitchen_reward.observed(data.qpos), jnp.float32)
        sites = [data.site(name).xpos for name in kitchen_reward.SITES]
        np.testing.assert_allclose(kitchen_reward.site_positions(state), sites, atol=1e-5)
        mocap = data.body("l7").xpos - data.body("mocap").xmat.reshape(3, 3) @ flange
        np.testing.assert_allclose(kitchen_reward.dragging_position(state), mocap, atol=1e-5)


def test_the_papers_reward_and_the_sparse_reward(env):
    state = jax.jit(lambda: env.step(env.reset(jax.random.key(5)), jnp.zeros(9)))()
    paper, sparse = dataclasses.replace(env, variant="paper"), dataclasses.replace(env, reward_type="sparse")
    error = np.asarray(state.obs[:23] - state.obs[23:], np.float64)
    parts = np.split(error[9:], [2, 4, 6, 8, 10, 11, 13])
    norms = np.array([np.linalg.norm(part) for part in parts])
    expected = -np.linalg.norm(error[:9]) - norms.sum() + sum(norms < [0.01 * len(part) for part in parts])
    assert float(paper.reward(state.obs)) == pytest.approx(expected, abs=1e-5)
    assert float(env.reward(state.obs)) == pytest.approx(float(state.reward), abs=0.05), "the hand lags slightly"
    batch = jnp.stack([state.obs, state.obs.at[9:23].set(state.obs[32:])])
    np.testing.assert_array_equal(env.success(batch), [False, True])
    np.testing.assert_array_equal(sparse.reward(batch), [0.0, 1.0])
    assert env.reward(batch).shape == paper.reward(batch[None]).shape[1:] == (2,)


def test_the_papers_variant_opens_the_appliances_of_the_text_from_a_closed_kitchen(env):
    paper = dataclasses.replace(env, variant="paper", noise=False)
    assert (paper.obs_size, paper.goal_states.shape, paper.initial_states.shape) == (46, (7, 23), (1, 23))
    indices = {"micro": {22}, "hinge": {20, 21}, "slide": {19}, "burner": {11, 12}}
    changed = [set(np.flatnonzero(goal != CLOSED).tolist()) - {20} for goal in paper.goal_states]
    assert changed == [set().union(*(indices[name] for name in group)) - {20} for group in TEXT_GOALS]
    assert not {17, 18} & set().union(*changed), "the text has no light"
    assert {22, 21, 11, 12} in changed, "the text's example: microwave, door and burner"
    states = jax.jit(jax.vmap(paper.reset))(jax.random.split(jax.random.key(1), 100))
    assert np.abs(states.obs[:, 9:23] - CLOSED[9:]).max() < 0.01, "everything is closed at the start"
    assert len(np.unique(states.obs[:, 23:], axis=0)) == 7, "every goal is drawn"
    assert not np.asarray(states.metrics["success"]).any()
    assert not np.asarray(jax.jit(jax.vmap(paper.fault))(states)).any()


def test_a_goal_of_the_papers_variant_is_reached_when_its_appliances_are_open_in_the_model(env):
    """The joints are set in the physics, so plate and block follow knob and switch as the model couples them."""
    paper = dataclasses.replace(env, variant="paper", noise=False)
    state = jax.jit(paper.reset)(jax.random.key(0))
    success, reward = jax.jit(paper.success), jax.jit(paper.reward)
    joints = {
        "micro": (17, -0.7),
        "hinge": (16, 1.45),
        "slide": (14, 0.37),
        "burner": (10, -0.88),
        "light": (13, -0.69),
    }

    def arrive(opened, goal):
        qpos = np.array(state.data.qpos)
        for name in opened:
            qpos[joints[name][0]] = joints[name][1]
        obs = jnp.asarray(np.concatenate([kitchen_reward.observed(qpos), goal]), jnp.float32)
        return bool(success(obs)), float(reward(obs))

    for goal, group in zip(paper.goal_states, TEXT_GOALS, strict=True):
        closed, reached = arrive((), goal), arrive(group, goal)
        assert (closed[0], reached[0]) == (False, True)
        assert reached[1] > 7.5 - 0.2, "all 8 components are within tolerance, the arm is near its goal"
        for missing in group:
            partly = arrive([name for name in group if name != missing], goal)
            assert not partly[0]
            assert closed[1] <= partly[1] < reached[1] - 1.0
        if "burner" in group:
            assert not arrive([name.replace("burner", "light") for name in group], goal)[0]


@pytest.mark.parametrize("name", list(benchmark.SCRIPTS))
def test_scripts_move_each_object_to_within_015_of_its_goal(env, name):
    script = benchmark.SCRIPTS[name]
    moved, state = jax.jit(lambda: benchmark.play(env, script))()
    assert abs(float(moved[-1]) - script.goal) < 0.15
    assert abs(float(moved[0]) - script.start) < 0.05
    assert not bool(env.fault(state))


def test_six_of_nine_action_components_do_nothing_as_released(env):
    exact = dataclasses.replace(env, noise=False)
    state, rest = exact.reset(jax.random.key(0)), jnp.zeros(9)
    step = jax.jit(exact.step)
    after_rest = step(state, rest)
    np.testing.assert_array_equal(step(state, rest.at[3:].set(1.0)).obs, after_rest.obs)
    up = step(state, rest.at[2].set(1.0))
    np.testing.assert_allclose(up.info["mocap"] - state.info["mocap"], [0, 0, 0.02], atol=1e-6)
    assert float(after_rest.obs[7]) < float(state.obs[7]) - 0.005, "joint 1 is negative, so the left finger closes"
