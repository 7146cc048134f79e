"""DHand lightbulb: observations, motion, starts, reward, both variants, the scripted grasp, and the tether of the bulb."""

import copy
import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from earl_jax import physics
from earl_jax.envs import make
from earl_jax.envs.dhand import lightbulb as task
from tests.envs.programs import program, run_actions, run_alone, starts

ENV = make("dhand_lightbulb")
PAPER = dataclasses.replace(ENV, variant="paper")


def start_at(x, y, env=ENV):
    return program(env, "start_at")(np.float32([x, y]))


@pytest.fixture(scope="module")
def model():
    return physics.load_model("dhand_lightbulb")


def test_the_model_keeps_the_originals_numbers(model):
    assert (model.nq, model.nv, model.nu, model.nmocap) == (30, 29, 16, 1)
    np.testing.assert_allclose(model.dof_damping[:7], [500, 500, 250, 250, 100, 100, 100])
    np.testing.assert_allclose(model.dof_armature[:7], 1.0)
    np.testing.assert_allclose(model.dof_damping[7:23], 1.0)
    np.testing.assert_allclose(model.actuator_gainprm[:, 0], 5.0)
    spread, bend = (-0.3, 0.3), (-0.2, 1.57)
    limits = [*[spread, bend, bend, bend] * 3, bend, (-2.57, 0.57), bend, bend]
    np.testing.assert_array_equal(model.actuator_ctrlrange, limits)
    np.testing.assert_array_equal(model.actuator_trnid[:, 0], np.arange(7, 23))
    assert model.body("bulb").mass[0] == pytest.approx(0.5)
    assert model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC


def test_the_start_is_the_state_in_which_the_originals_reset_comes_to_rest(model):
    model = copy.copy(model)
    model.opt.timestep = 0.005
    data = mujoco.MjData(model)
    middle, half = model.actuator_ctrlrange.mean(axis=1), np.ptp(model.actuator_ctrlrange, axis=1) / 2
    data.qpos[:7] = [0.7, 0.133, -0.503, 1.067, -2.308, 0.976, 0.0973]
    data.qpos[23:26] = [0.72, 0.15, 0.78]
    data.mocap_pos[0], data.mocap_quat[0] = (task.LOW + task.HIGH) / 2, [0, 1, 0, 0]
    data.ctrl[:] = middle - 0.75 * half
    mujoco.mj_step(model, data, 36_000)
    assert np.abs(data.qvel).max() < 1e-6
    np.testing.assert_allclose(data.qpos[:23], task.START_JOINTS, atol=1e-7)
    np.testing.assert_allclose(data.qpos[23:], [0.72, 0.15, task.REST, 1, 0, 0, 0], atol=1e-7)
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.site("grasp").xpos, task.START_HAND, atol=1e-7)


def test_the_observation_is_mujocos_own():
    actions = np.random.default_rng(0).uniform(-1, 1, (5, 22)).astype(np.float32)
    state = start_at(0.7, 0.2)
    for action in actions:
        state = program(ENV, "step")(state, action)
    data, obs = physics.mujoco_data(ENV.name, state.data), np.asarray(state.obs)
    np.testing.assert_allclose(obs[:16], data.qpos[7:23], atol=1e-6)
    np.testing.assert_allclose(obs[16:23], data.qpos[:7], atol=1e-6)
    np.testing.assert_allclose(obs[23:26], data.body("bulb").xpos, atol=1e-6)
    np.testing.assert_allclose(obs[29:32], obs[26:29] - obs[23:26], atol=1e-6)
    np.testing.assert_allclose(obs[32:], task.TARGET)
    np.testing.assert_allclose(obs[26:29], data.site("grasp").xpos, atol=2e-3)


def test_the_papers_variant_lists_the_bulbs_pose_the_distances_and_its_goal(model):
    """MuJoCo's 30 joint values are the hand's 16, the arm's 7 and the pose of the bulb, as position and quaternion."""
    state = start_at(0.7, 0.2, PAPER)
    turn = Rotation.from_euler("XYZ", [0.4, -0.9, 2.5])
    quat = np.float32(turn.as_quat(scalar_first=True))
    state = state.replace(data=state.data.replace(qpos=state.data.qpos.at[26:].set(quat)))
    hand = np.float32([0.71, 0.18, 0.84])
    vector = np.asarray(program(PAPER, "observe")(state, np.zeros(22), state.data, np.tile(hand, 9))[1])
    assert (len(vector), PAPER.observation_size, 16 + 7 + 7) == (35, 38, model.nq)
    bulb = np.asarray(state.data.qpos[23:26])
    np.testing.assert_array_equal(vector[:26], np.concatenate([state.data.qpos[7:23], state.data.qpos[:7], bulb]))
    np.testing.assert_allclose(vector[26:29], [0.4, -0.9, 2.5], atol=1e-6)
    np.testing.assert_allclose(vector[29:], np.concatenate([hand - bulb, bulb - task.TARGET]), atol=1e-6)
    np.testing.assert_array_equal(state.obs[35:], task.TARGET)
    other = program(PAPER, "with_goal")(state, PAPER.initial_states[0])
    np.testing.assert_array_equal(other.obs[:35], state.obs[:35], err_msg="the state depends on no goal")


def test_the_papers_variant_starts_all_over_the_table_and_its_demonstrations_where_the_hand_reaches():
    states = starts(PAPER)
    away = np.asarray(states.obs[:, 23:25]) - task.MIDDLE
    assert 0.37 < np.linalg.norm(away, axis=1).max() <= task.SPREAD + 1e-6
    assert np.median(np.linalg.norm(away, axis=1)) == pytest.approx(task.SPREAD / np.sqrt(2), abs=0.02), "uniform"
    assert not jax.jit(jax.vmap(PAPER.irreversible))(states).any()
    moved = jax.jit(jax.vmap(PAPER.step))(states, jnp.zeros((len(away), 22)))
    assert np.abs(np.asarray(moved.data.qpos - states.data.qpos)[:, 23:]).max() < 1e-3, "no bulb starts inside the hand"
    assert (np.linalg.norm(PAPER.initial_states[:, :2] - task.MIDDLE, axis=1) < task.SPREAD + 1e-6).all()
    first = next(PAPER.demonstrations.script.starts(0)).forward.obs[23:25]
    assert ((first >= task.START_LOW) & (first <= task.START_HIGH)).all()


def test_the_papers_variant_has_the_same_reward_success_and_script():
    rng = np.random.default_rng(3)
    obs = np.tile(start_at(0.7, 0.2).obs, (50, 1))
    obs[:, 23:26] = rng.uniform([0.5, 0, 0.77], [0.9, 0.3, 1.1], (50, 3))
    obs[::2, 23:26] = task.TARGET + rng.uniform(-0.1, 0.1, (25, 3))
    obs[:, 29:32] = obs[:, 26:29] - obs[:, 23:26]
    listed = np.hstack([obs[:, :26], np.zeros((50, 3)), obs[:, 29:32], obs[:, 23:26] - task.TARGET, obs[:, 32:]])

    def answers(env, obs):
        parts = env.reward(obs), env.success(obs), env.map.position(obs), jax.vmap(env.demonstrations.expert)(obs)
        return dict(zip(("reward", "success", "map", "expert"), parts, strict=True))

    program = jax.jit(answers, static_argnums=0)
    paper, ours = program(PAPER, np.float32(listed)), program(ENV, obs)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=1e-4), paper, ours)
    assert paper["success"].any()


def test_starts_cover_the_table_and_stay_inside():
    state = starts(ENV)
    bulb = np.asarray(state.obs[:, 23:26])
    assert (bulb[:, :2] >= task.START_LOW).all()
    assert (bulb[:, :2] <= task.START_HIGH).all()
    assert (np.ptp(bulb[:, :2], axis=0) > 0.97 * (task.START_HIGH - task.START_LOW)).all()
    assert np.linalg.norm(bulb - [0.7, 0.15, 0.885], axis=1).max() < 0.45
    np.testing.assert_allclose(bulb[:, 2], task.REST)
    assert np.ptp(np.asarray(state.obs[:, :23]), axis=0).max() == 0
    np.testing.assert_allclose(ENV.initial_states[[0, -1], :2], [task.START_LOW, task.START_HIGH], rtol=1e-6)
    assert not np.asarray(state.metrics["success"]).any()


def test_the_wrist_follows_its_command_within_its_range():
    """Two lanes, one for each direction."""
    direction = np.array([1.0, -1.0], np.float32)
    states = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), start_at(0.86, 0.3))
    actions = np.zeros((40, 2, 22), np.float32)
    actions[:, :, 16:] = direction[:, None]
    states = jax.device_get(run_actions(ENV, states, actions))
    target, quat = states.data.mocap_pos[:, :, 0], states.data.mocap_quat[:, :, 0]
    np.testing.assert_allclose(target[0] - task.START_TARGET, np.tile(0.01 * direction[:, None], 3), atol=1e-6)
    np.testing.assert_allclose(target[-1], [task.HIGH, task.LOW], atol=1e-6)
    yaw = -2.0 * np.arctan2(quat[..., 2], quat[..., 1])
    np.testing.assert_allclose(yaw[[0, -1]], np.outer([0.02, np.pi / 6], direction), atol=1e-5)
    assert np.abs(quat[..., [0, 3]]).max() == 0, "roll and pitch are inert"
    left = np.linalg.norm(states.obs[-1, :, 26:29] - (target[-1] + task.FROM_TARGET), axis=1)
    assert left.max() < 0.12, "the hand follows, turned by 30 degrees"


def documented_reward(obs):
    """Return the documented formula in float64 for one observation."""
    bulb, hand, goal = obs[23:26], obs[26:29], obs[32:35]
    distance = np.linalg.norm(bulb - goal)
    total = -np.linalg.norm(hand - bulb) - 2 * np.hypot(*(bulb - goal)[:2]) - 2 * abs(bulb[2] - goal[2])
    total -= 2.0 if hand[2] < 0.75 else 0.0
    for level, radius, worth in ((0.1, 0.2, 0.9), (0.04, 0.1, 2.25)):
        if abs(bulb[2] - goal[2]) < level:
            total += worth + (worth if distance < radius else 0.0)
    return total


def test_the_reward_is_the_documented_formula():
    rng = np.random.default_rng(1)
    obs = np.zeros((400, 35), np.float32)
    obs[:, 23:26] = rng.uniform([0.5, 0, 0.77], [0.9, 0.3, 1.1], (400, 3))
    obs[:, 26:29] = rng.uniform([0.5, 0, 0.68], [0.9, 0.3, 1.0], (400, 3))
    obs[:, 32:] = np.where(np.arange(400)[:, None] % 2, task.TARGET, ENV.initial_states[np.arange(400) % 9])
    obs[::3, 23:26] = obs[::3, 32:] + rng.uniform(-0.08, 0.08, (134, 3))
    expected = [documented_reward(row) for row in obs.astype(np.float64)]
    np.testing.assert_allclose(program(ENV, "reward")(obs), expected, atol=1e-5)
    near = np.linalg.norm(obs[:, 23:26] - obs[:, 32:], axis=1) < 0.1
    np.testing.assert_array_equal(program(ENV, "success")(obs), near)
    np.testing.assert_array_equal(program(dataclasses.replace(ENV, reward_type="sparse"), "reward")(obs), near)


def test_the_scripted_grasp_lifts_and_holds_and_no_action_earns_the_published_return():
    """Lanes from the corners of the starts and from ordinary ones act not at all, at random, and by the script."""
    named = task.TARGET[:2] + np.float32([[0.0, 0.0], [0.04, 0.0], [-0.04, 0.0], [0.0, 0.04], [0.0, -0.04]])
    parts = jax.device_get((jax.jit(jax.vmap(ENV.start_at))(named), starts(ENV, count=7)))
    lanes = jax.tree.map(lambda *leaves: np.concatenate(3 * leaves), *parts)

    def step(states, key):
        noise = jax.random.uniform(key, (12, 22), minval=-1.0, maxval=1.0)
        action = jnp.concatenate([jnp.zeros((12, 22)), noise, jax.vmap(ENV.demonstrations.expert)(states.obs[24:])])
        states = jax.vmap(ENV.step)(states, action)
        return states, (states.reward, states.metrics["success"] > 0, states.obs[:, 25], jax.vmap(ENV.fault)(states))

    run = jax.jit(lambda lanes: jax.lax.scan(step, lanes, jax.random.split(jax.random.key(0), 400))[1])
    reward, success, height, fault = (np.asarray(part).reshape(400, 3, 12) for part in run(lanes))
    held = np.lib.stride_tricks.sliding_window_view(success, 50, axis=0).all(axis=-1).any(axis=0)
    assert held[2].all()
    assert not success[:, 0].any()
    assert (height.max(axis=0)[2] > task.REST + 0.1).all()
    returns = reward.sum(axis=0)[:, 5:].mean(axis=1)
    assert -290 < returns[0] < -190
    assert -550 < returns[1] < -200
    assert 2000 < returns[2] < 2400
    assert not fault.any()


def test_the_grasp_also_puts_the_bulb_down_at_a_goal_on_the_table():
    state = ENV.with_goal(start_at(0.8, 0.1), jnp.asarray(ENV.initial_states[0]))

    def step(state, _):
        state = ENV.step(state, ENV.demonstrations.expert(state.obs))
        return state, (state.obs[25], ENV.success(state.obs))

    height, success = map(np.asarray, jax.jit(lambda state: jax.lax.scan(step, state, length=120)[1])(state))
    assert success[-1]
    assert height.max() > task.REST + 0.05, "carried, not pushed"
    assert height[-1] < task.REST + 0.02


def test_the_tether_holds_a_thrown_bulb():
    """The bulb starts with 3 m/s towards the edge of the table."""
    state = start_at(0.72, 0.15)
    thrown = state.replace(data=state.data.replace(qvel=state.data.qvel.at[23].set(3.0).at[24].set(1.0)))
    states = run_alone(ENV, thrown, np.zeros((40, 22)))
    bulb = states.obs[:, 23:26]
    assert 0.4 < np.linalg.norm(bulb - [0.7, 0.15, 0.885], axis=1).max() < 0.5
    assert bulb[:, 2].min() > 0.74
    assert not jax.jit(jax.vmap(ENV.fault))(states).any()


def test_fingers_pressed_onto_the_table_fold_and_do_not_penetrate_it(model):
    """Stiff fingers point straight down while the wrist moves down; without the guard, the tips end 6 cm deep."""
    actions = np.zeros((40, 22))
    actions[:, [1, 5, 9]], actions[:, [2, 3, 6, 7, 10, 11]], actions[15:, 18] = 1.0, -0.1, -1.0
    states = run_alone(ENV, start_at(0.58, 0.3), actions)
    pressed, target = states.info["pressed"], states.data.mocap_pos[:, 0, 2]
    assert pressed.any()
    assert (np.diff(target)[pressed[:-1]] >= 0).all(), "the target does not go down while the fingers are pressed"
    data = physics.mujoco_data(ENV.name, jax.tree.map(lambda leaf: leaf[-1], states.data))
    assert min(data.site(f"{finger}_tip").xpos[2] for finger in ("FF", "MF", "PF")) > task.TABLE + 0.015
    fingers, (low, high) = states.obs[:, :12], model.actuator_ctrlrange[:12].T
    assert (fingers > low - 0.1).all()
    assert (fingers < high + 0.1).all()
