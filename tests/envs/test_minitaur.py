"""Minitaur pen: motors by the closed form, bodies that differ from reset to reset, rewards, walls, and the released reset."""

import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from benchmarks.physics import minitaur_trots
from earl_jax import assets, physics
from earl_jax.envs import make
from earl_jax.envs.minitaur import pen as minitaur_pen
from earl_jax.envs.minitaur.motors import DIRECTION, POSITIONS, MinitaurMotors, torque
from tests.envs.programs import first_state, program, run_alone, starts

ENV = make("minitaur_pen")
NOMINAL = make("minitaur_pen", randomize=False)
STANDING = np.array(minitaur_pen.STANDING[0])
ANGLES = STANDING[POSITIONS] * DIRECTION
"""The motors' angles in the standing pose."""


def test_model_and_goals_as_released():
    assert ENV.simulator.timestep == pytest.approx(0.002)
    assert {tuple(goal) for goal in ENV.goal_states.round(1).tolist()} == {
        (x, y) for x in np.float32([-0.4, -0.2, 0.2, 0.4]).round(1).tolist() for y in np.float32([0, 0.2, 0.4]).tolist()
    }
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
    exerted, reported = torque(xp, *map(xp.asarray, (angle - command, speed, volts, viscosity)))
    expected = np.array([closed_form(*row) for row in zip(angle, speed, command, volts, viscosity, strict=True)])
    np.testing.assert_allclose(np.stack([exerted, reported], axis=1), expected, atol=1e-5)
    assert (np.abs(expected[:, 0]) == 3.5).any()
    assert (np.abs(expected[:, 0]) < 1).any()


def run_motors(motors, command, memory):
    return motors(np, STANDING, np.zeros(22), command, memory)


def test_a_command_is_clipped_to_three_tenths_of_a_radian_from_the_angle():
    memory = np.r_[np.zeros(16), 16.0, 0.0]
    far, near = (run_motors(ENV.simulator.actuator, ANGLES + lead, memory)[0] for lead in (2.0, 0.3))
    np.testing.assert_allclose(far, near, atol=1e-6)
    np.testing.assert_allclose(far * DIRECTION, closed_form(0.0, 0.0, 0.3, 16.0, 0.0)[0], rtol=1e-5)


def test_a_motor_that_is_hot_for_a_second_shuts_down_until_the_next_reset():
    motors, ahead, memory = MinitaurMotors(), ANGLES + 0.3 * (np.arange(8) < 3), np.r_[np.zeros(16), 20.0, 0.0]
    for _ in range(500):
        controls, memory = run_motors(motors, ahead, memory)
    assert (np.abs(controls[:3]) > 2.45).all()
    np.testing.assert_allclose(run_motors(motors, ANGLES, memory)[0], 0, atol=1e-6)
    controls, memory = run_motors(motors, ahead, memory)
    np.testing.assert_array_equal(controls[:3], 0.0)
    assert (memory[8:11] > 0).all(), "it still reports the commanded torque"
    for _ in range(600):
        _, memory = run_motors(motors, ANGLES, memory)
    np.testing.assert_array_equal(run_motors(motors, ahead, memory)[0][:3], 0.0)
    controls, _ = run_motors(dataclasses.replace(motors, overheat=False), ahead, memory)
    assert (np.abs(controls[:3]) > 2.45).all()


def test_legs_are_mapped_to_motors_as_released():
    np.testing.assert_allclose(minitaur_pen.legs_to_motors(np.zeros(8)), np.pi - np.pi / 4 * 1.5, rtol=1e-6)
    swung = minitaur_pen.legs_to_motors(np.eye(8)[0])
    np.testing.assert_allclose(swung[:2] - swung[2], [np.pi / 4, -np.pi / 4], atol=1e-6)
    np.testing.assert_allclose(minitaur_pen.legs_to_motors(np.eye(8)[6])[4:6], np.pi - np.pi / 4 * 2.5, rtol=1e-6)


def test_the_standing_robot_is_in_the_state_after_the_released_reset():
    model = mujoco.MjModel.from_xml_path(str(assets.mjcf("minitaur_pen")))
    data, memory = mujoco.MjData(model), np.r_[np.zeros(16), 16.0, 0.0]
    data.qpos[7::2], data.qpos[8::2] = DIRECTION * np.pi / 2, DIRECTION * -2.1834
    for _ in range(100):
        data.ctrl[:], memory = NOMINAL.simulator.actuator(np, data.qpos, data.qvel, np.full(8, np.pi / 2), memory)
        mujoco.mj_step(model, data)
    for ours, theirs in zip(minitaur_pen.STANDING, (data.qpos, data.qvel, data.qacc_warmstart), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(minitaur_pen.REPORTED, memory[8:16], rtol=1e-6)


def test_the_observation_is_the_released_one():
    states = run_alone(NOMINAL, first_state(NOMINAL), np.random.default_rng(0).uniform(-1, 1, (5, 8)))
    obs, state = states.obs[-1], jax.tree.map(lambda leaf: leaf[-1], states.data)
    data = physics.mujoco_data("minitaur_pen", state)
    motors = [data.joint(joint) for joint in range(1, 17, 2)]
    np.testing.assert_allclose(obs[:8], DIRECTION * [motor.qpos[0] for motor in motors], rtol=1e-5)
    np.testing.assert_allclose(obs[8:16], DIRECTION * [motor.qvel[0] for motor in motors], rtol=1e-5)
    np.testing.assert_allclose(obs[16:24], state.memory[8:16])
    np.testing.assert_allclose(np.roll(obs[24:28], 1), data.body("base").xquat, atol=1e-5)
    np.testing.assert_allclose(obs[28:30], data.body("base").xpos[:2], atol=1e-6)
    np.testing.assert_allclose(obs[30:], states.info["goal"][-1])


def test_rewards_by_hand():
    away, near = np.zeros((2, 32), np.float32)
    away[8:24], away[28:] = np.r_[np.full(8, 10.0), np.full(4, 2.0), np.full(4, -1.0)], [0.1, 0.2, 0.4, -0.2]
    near[:], near[28:30] = away, [0.4, -0.11]
    power, rows = 8 * 5.0, np.stack([away, near])
    paper, sparse = (dataclasses.replace(ENV, **change) for change in ({"variant": "paper"}, {"reward_type": "sparse"}))
    assert program(ENV, "reward")(rows)[0] == pytest.approx(-2 * (0.3 + 0.4) - 0.005 * power * 0.002, rel=1e-5)
    assert program(paper, "reward")(rows)[0] == pytest.approx(-2 * 0.5 + 0.02 * power, rel=1e-5)
    assert program(ENV, "success")(rows).tolist() == program(sparse, "reward")(rows).tolist() == [0, 1]


def test_bodies_differ_from_reset_to_reset_within_the_released_ranges():
    states, nominal = starts(ENV), physics.load_model("minitaur_pen")
    volts, viscosity = np.asarray(states.data.memory[:, 16:]).T
    assert 14.8 <= volts.min() < 14.9 < 16.7 < volts.max() <= 16.8
    assert 0 <= viscosity.min() < 5e-4 < 9.5e-3 < viscosity.max() <= 0.01
    fields = jax.device_get(jax.jit(jax.vmap(ENV.simulator.variation))(states.data.constants))
    factor = fields["body_mass"][:, 1:] / nominal.body_mass[1:]
    assert 0.8 <= factor.min() < 0.81 < 1.19 < factor.max() <= 1.2
    np.testing.assert_allclose(factor[:, 1::2], factor[:, 1:2].repeat(8, 1), rtol=1e-5)
    np.testing.assert_allclose(fields["body_subtreemass"][:, 0], fields["body_mass"].sum(axis=1), rtol=1e-5)
    changed = (fields["pair_friction"] != nominal.pair_friction.astype(np.float32)).any(axis=0)
    assert changed.sum() == 16
    sliding = fields["pair_friction"][:, changed]
    assert 0.8 <= sliding.min() < 0.82 < 1.48 < sliding.max() <= 1.5


def test_closed_walls_stop_a_crouching_robot_and_floating_ones_do_not():
    crouched = minitaur_trots.trot([0.5, 0.3, 2.0, 0.5, np.pi / 2], 1000)
    reached = {}
    for walls in ("closed", "floating"):
        env = dataclasses.replace(NOMINAL, walls=walls)
        state = first_state(env)
        state = state.replace(data=state.data.replace(qpos=state.data.qpos.at[0].set(1.1)))
        reached[walls] = np.abs(run_alone(env, state, crouched).data.qpos[:, :2]).max()
    assert reached["closed"] < 1.5
    assert reached["floating"] > 1.6
