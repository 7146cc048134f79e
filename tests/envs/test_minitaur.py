"""Minitaur pen: motors by the closed form, bodies that differ from reset to reset, walls, and the recorded robot."""

import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from benchmarks.physics import minitaur_trots
from earl_jax import assets, physics
from earl_jax.envs import make
from earl_jax.envs.minitaur import body as minitaur_body
from earl_jax.envs.minitaur import pen as minitaur_pen
from earl_jax.envs.minitaur.motors import DIRECTION, POSITIONS, MinitaurMotors, legs_to_motors, torque
from tests.conftest import take_lane


@pytest.fixture(scope="module")
def env():
    return make("minitaur_pen", engine="c")


@pytest.fixture(scope="module")
def nominal_env():
    return make("minitaur_pen", engine="c", randomize=False)


def play(env, state, actions):
    """Return the last state and qpos [T, 23] after every one of the `actions [T, 8]`."""

    def step(state, action):
        state = env.step(state, action)
        return state, state.data.qpos

    return jax.lax.scan(step, state, jnp.asarray(actions))


def test_numbers_as_released(env):
    assert (env.state_size, env.goal_size, env.action_size) == (30, 2, 8)
    assert (env.train_horizon, env.eval_horizon, env.goal_change) == (100_000, 1000, 2000)
    assert env.simulator.timestep == pytest.approx(0.002)
    assert {tuple(goal) for goal in env.goal_states.round(1).tolist()} == {
        (x, y) for x in np.float32([-0.4, -0.2, 0.2, 0.4]).round(1).tolist() for y in np.float32([0, 0.2, 0.4]).tolist()
    }
    assert not env.sparse
    model = physics.load_model("minitaur_pen")
    assert (model.nv, model.nu, model.neq) == (22, 8, 4)
    assert model.body_mass.sum() == pytest.approx(6.0)


def closed_form(angle, speed, command, volts, viscosity):
    """Return the exerted and the reported torque of one motor, step by step by the closed form."""
    pwm = min(max(-1.0 * (angle - command) - 0.02 * speed, -1.0), 1.0)
    reported = min(max(0.0954 * pwm * volts / 0.186, -5.7), 5.7)
    current = min(max(pwm * volts - (0.0954 + viscosity) * speed, -50.0), 50.0) / 0.186
    table, size = [0.0, 1.0, 1.9, 2.45, 3.0, 3.25, 3.5], abs(current)
    if size >= 60:
        return np.sign(current) * 3.5, reported
    index, share = int(size // 10), size % 10 / 10
    return np.sign(current) * (table[index] + share * (table[index + 1] - table[index])), reported


@pytest.mark.parametrize("xp", [np, jnp])
def test_motors_follow_the_closed_form(xp):
    rng = np.random.default_rng(0)
    angle, command = rng.uniform(-3, 3, (2, 500))
    speed, volts, viscosity = rng.uniform(-60, 60, 500), rng.uniform(14.8, 16.8, 500), rng.uniform(0, 0.01, 500)
    speed[:250] *= 0.05
    exerted, reported = torque(xp, *map(xp.asarray, (angle - command, speed, volts, viscosity)), 1.0, 0.02)
    expected = np.array([closed_form(*row) for row in zip(angle, speed, command, volts, viscosity, strict=True)])
    np.testing.assert_allclose(np.stack([exerted, reported], axis=1), expected, atol=1e-5)
    assert (np.abs(expected[:, 0]) == 3.5).any()
    assert (np.abs(expected[:, 0]) < 1).any()


def run_motors(motors, qpos, command, memory):
    return motors(np, qpos, np.zeros(22), command, memory)


def test_a_command_is_clipped_to_three_tenths_of_a_radian_from_the_angle(env):
    qpos, memory = np.array(minitaur_pen.STANDING[0]), np.r_[np.zeros(16), 16.0, 0.0]
    ahead = qpos[POSITIONS] * DIRECTION + 2.0
    far, _ = run_motors(env.actuator, qpos, ahead, memory)
    near, _ = run_motors(env.actuator, qpos, ahead - 1.7, memory)
    np.testing.assert_allclose(far, near, atol=1e-6)
    expected, _ = closed_form(0.0, 0.0, 0.3, 16.0, 0.0)
    np.testing.assert_allclose(far * DIRECTION, expected, rtol=1e-5)


def test_a_motor_that_is_hot_for_a_second_shuts_down_until_the_next_reset():
    motors, standing = MinitaurMotors(), np.array(minitaur_pen.STANDING[0])
    ahead, memory = standing[POSITIONS] * DIRECTION + 0.3, np.r_[np.zeros(16), 20.0, 0.0]
    ahead[3:] -= 0.3
    for _ in range(500):
        controls, memory = run_motors(motors, standing, ahead, memory)
    assert (np.abs(controls[:3]) > 2.45).all()
    at_rest, _ = run_motors(motors, standing, standing[POSITIONS] * DIRECTION, memory)
    np.testing.assert_allclose(at_rest, 0, atol=1e-6)
    controls, memory = run_motors(motors, standing, ahead, memory)
    np.testing.assert_array_equal(controls[:3], 0.0)
    assert (memory[8:11] > 0).all(), "it still reports the commanded torque"
    for _ in range(600):
        _, memory = run_motors(motors, standing, standing[POSITIONS] * DIRECTION, memory)
    controls, _ = run_motors(motors, standing, ahead, memory)
    np.testing.assert_array_equal(controls[:3], 0.0)
    controls, _ = run_motors(dataclasses.replace(motors, overheat=False), standing, ahead, memory)
    assert (np.abs(controls[:3]) > 2.45).all()


@pytest.mark.parametrize("overheat", [True, False])
def test_bound_motors_equal_the_actuator_in_every_substep(overheat):
    motors, lanes, rng = MinitaurMotors(overheat=overheat), 6, np.random.default_rng(0)
    qpos, qvel, ctrl = np.zeros((lanes, 23)), np.zeros((lanes, 22)), np.zeros((lanes, 8))
    command = rng.uniform(-2, 2, (lanes, 8))
    hot = rng.choice([0.0, 1.0, 498.0, 499.0, 500.0, 501.0], (lanes, 8))
    memory = np.hstack(
        [hot, np.zeros((lanes, 8)), rng.uniform(14.8, 16.8, (lanes, 1)), rng.uniform(0, 0.01, (lanes, 1))]
    )
    bound, start = motors.bind(qpos, qvel, ctrl), memory
    bound.start(command, memory)
    for _ in range(5):
        qpos[:], qvel[:] = rng.uniform(-3, 3, qpos.shape), rng.uniform(-60, 60, qvel.shape)
        bound.apply()
        controls, memory = motors(np, qpos, qvel, command, memory)
        np.testing.assert_allclose(ctrl, controls, atol=1e-12)
        np.testing.assert_allclose(bound.finish(), memory, atol=1e-12)
    assert (memory[:, :8] > 500).sum() > (start[:, :8] > 500).sum(), "some motors shut down"
    assert (ctrl == 0).any() == overheat


def test_legs_are_mapped_to_motors_as_released():
    np.testing.assert_allclose(legs_to_motors(np, np.zeros(8)), np.pi - np.pi / 4 * 1.5)
    swung = legs_to_motors(np, np.eye(8)[0])
    np.testing.assert_allclose(swung[:2] - swung[2], [np.pi / 4, -np.pi / 4], atol=1e-6)
    np.testing.assert_allclose(legs_to_motors(np, np.eye(8)[6])[4:6], np.pi - np.pi / 4 * 2.5, rtol=1e-6)


def test_the_standing_robot_is_in_the_state_after_the_released_reset(nominal_env):
    model = mujoco.MjModel.from_xml_path(str(assets.mjcf("minitaur_pen")))
    data, memory = mujoco.MjData(model), np.r_[np.zeros(16), 16.0, 0.0]
    data.qpos[7::2], data.qpos[8::2] = DIRECTION * np.pi / 2, DIRECTION * -2.1834
    for _ in range(100):
        data.ctrl[:], memory = nominal_env.actuator(np, data.qpos, data.qvel, np.full(8, np.pi / 2), memory)
        mujoco.mj_step(model, data)
    for ours, theirs in zip(minitaur_pen.STANDING, (data.qpos, data.qvel, data.qacc_warmstart), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(minitaur_pen.REPORTED, memory[8:16], rtol=1e-6)


def test_the_observation_is_the_released_one(nominal_env):
    state, step = jax.jit(nominal_env.reset)(jax.random.key(0)), jax.jit(nominal_env.step)
    for action in np.random.default_rng(0).uniform(-1, 1, (5, 8)):
        state = step(state, action)
    data = physics.mujoco_data("minitaur_pen", state.data)
    motors = [data.joint(int(i)) for i in range(1, 17, 2)]
    np.testing.assert_allclose(
        state.obs[:8], [j.qpos[0] * s for j, s in zip(motors, DIRECTION, strict=True)], rtol=1e-5
    )
    np.testing.assert_allclose(
        state.obs[8:16], [j.qvel[0] * s for j, s in zip(motors, DIRECTION, strict=True)], rtol=1e-5
    )
    np.testing.assert_allclose(state.obs[16:24], state.data.memory[8:16])
    np.testing.assert_allclose(np.roll(state.obs[24:28], 1), data.body("base").xquat, atol=1e-5)
    np.testing.assert_allclose(state.obs[28:30], data.body("base").xpos[:2], atol=1e-6)
    np.testing.assert_allclose(state.obs[30:], state.info["goal"])


def test_rewards_by_hand(env):
    obs = np.zeros(32, np.float32)
    obs[8:24], obs[28:] = np.r_[np.full(8, 10.0), np.full(4, 2.0), np.full(4, -1.0)], [0.1, 0.2, 0.4, -0.2]
    power = 8 * 5.0
    assert float(env.reward(obs)) == pytest.approx(-2 * (0.3 + 0.4) - 0.005 * power * 0.002, rel=1e-5)
    paper = dataclasses.replace(env, variant="paper")
    assert float(paper.reward(obs)) == pytest.approx(-2 * 0.5 + 0.02 * power, rel=1e-5)
    assert not bool(env.success(obs))
    obs[28:30] = [0.4, -0.11]
    assert bool(env.success(obs))
    assert float(dataclasses.replace(env, reward_type="sparse").reward(obs)) == 1.0
    with pytest.raises(ValueError, match="closed, floating"):
        make("minitaur_pen", walls="none")
    with pytest.raises(ValueError, match="released, paper"):
        make("minitaur_pen", variant="other")


def test_bodies_differ_from_reset_to_reset_within_the_released_ranges(env):
    states = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(1), 400))
    volts, viscosity = np.asarray(states.data.memory[:, 16:]).T
    assert 14.8 <= volts.min() < 14.9 < 16.7 < volts.max() <= 16.8
    assert 0 <= viscosity.min() < 5e-4 < 9.5e-3 < viscosity.max() <= 0.01
    body, fields = (
        minitaur_body.nominal("minitaur_pen"),
        jax.jit(jax.vmap(env.simulator.variation))(states.data.constants),
    )
    factor = np.asarray(fields["body_mass"][:, 1:] / body.mass[1:])
    assert 0.8 <= factor.min() < 0.81 < 1.19 < factor.max() <= 1.2
    np.testing.assert_allclose(factor[:, 1::2], factor[:, 1:2].repeat(8, 1), rtol=1e-5)
    np.testing.assert_allclose(fields["body_subtreemass"][:, 0], fields["body_mass"].sum(axis=1), rtol=1e-5)
    friction = np.asarray(fields["pair_friction"])
    changed = (friction != body.friction).any(axis=0)
    assert changed.sum() == 16
    assert 0.8 <= friction[:, changed].min() < 0.82 < 1.48 < friction[:, changed].max() <= 1.5


def test_every_lane_is_simulated_with_its_own_body(env):
    states = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(2), 3))
    run = jax.jit(jax.vmap(lambda s: play(env, s, jnp.tile(jnp.eye(8)[4], (20, 1)))[0].obs))
    obs, reversed_obs = run(states), run(take_lane(states, slice(None, None, -1)))
    np.testing.assert_array_equal(obs[::-1, :30], reversed_obs[:, :30])
    assert np.abs(obs[0, :8] - obs[1, :8]).max() > 1e-3


def state_at_the_wall(env):
    state = jax.jit(env.reset)(jax.random.key(0))
    return state.replace(data=state.data.replace(qpos=state.data.qpos.at[0].set(1.1)))


def test_closed_walls_stop_a_crouching_robot_and_floating_ones_do_not(nominal_env):
    crouched = minitaur_trots.trot([0.5, 0.3, 2.0, 0.5, np.pi / 2], 1000)
    reached = {}
    for walls in minitaur_pen.WALLS:
        env = dataclasses.replace(nominal_env, walls=walls)
        reached[walls] = float(
            np.abs(jax.jit(lambda s, e=env: play(e, s, crouched)[1])(state_at_the_wall(env))[:, :2]).max()
        )
    assert reached["closed"] < 1.5
    assert reached["floating"] > 1.6
