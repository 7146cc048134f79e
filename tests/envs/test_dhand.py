"""DHand lightbulb: observations, motion, starts, reward, the scripted grasp, and the tether of the bulb."""

import copy
import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from earl_jax import assets, demos, physics
from earl_jax.envs import make
from earl_jax.envs.dhand import lightbulb as task
from tests.conftest import take_lane
from tests.envs import grasp as benchmark


@pytest.fixture(scope="module")
def env():
    return make("dhand_lightbulb", engine="c")


@pytest.fixture(scope="module")
def model():
    return physics.load_model("dhand_lightbulb")


@pytest.fixture(scope="module")
def step(env):
    return jax.jit(env.step)


@pytest.fixture(scope="module")
def start_at(env):
    return jax.jit(env.start_at)


def run_actions(env, state, actions):
    """Return the states after every action of `actions [steps, lanes, 22]`, from a batch of lanes."""

    def step(state, action):
        state = jax.vmap(env.step)(state, action)
        return state, state

    return jax.jit(lambda state: jax.lax.scan(step, state, actions)[1])(state)


def add_lane_axis(state):
    return jax.tree.map(lambda leaf: leaf[None], state)


def test_the_model_keeps_the_originals_numbers(model):
    assert (model.nq, model.nv, model.nu, model.nmocap) == (30, 29, 16, 1)
    np.testing.assert_allclose(model.dof_damping[:7], [500, 500, 250, 250, 100, 100, 100])
    np.testing.assert_allclose(model.dof_armature[:7], 1.0)
    np.testing.assert_allclose(model.dof_damping[7:23], 1.0)
    np.testing.assert_allclose(model.actuator_gainprm[:, 0], 5.0)
    np.testing.assert_allclose(
        model.actuator_ctrlrange, np.stack([task.FINGER_LOW, task.FINGER_HIGH], axis=1), rtol=1e-6
    )
    np.testing.assert_array_equal(model.actuator_trnid[:, 0], np.arange(7, 23))
    assert model.body("bulb").mass[0] == pytest.approx(0.5)
    assert model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC


def test_the_start_is_the_state_in_which_the_originals_reset_comes_to_rest(env, model):
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


def test_the_observation_is_mujocos_own(env, start_at, step):
    state = start_at(jnp.array([0.7, 0.2]))
    rng = np.random.default_rng(0)
    for _ in range(5):
        before = state
        state = step(state, jnp.asarray(rng.uniform(-1, 1, 22), jnp.float32))
    data = physics.mujoco_data(env.name, state.data)
    obs = np.asarray(state.obs)
    np.testing.assert_allclose(obs[:16], data.qpos[7:23], atol=1e-6)
    np.testing.assert_allclose(obs[16:23], data.qpos[:7], atol=1e-6)
    np.testing.assert_allclose(obs[23:26], data.body("bulb").xpos, atol=1e-6)
    np.testing.assert_allclose(obs[29:32], obs[26:29] - obs[23:26], atol=1e-6)
    np.testing.assert_allclose(obs[32:], task.TARGET)
    np.testing.assert_allclose(obs[26:29], data.site("grasp").xpos, atol=2e-3)
    model = physics.load_model(env.name, env.simulator.timestep)
    late = physics.mujoco_data(env.name, before.data)
    late.mocap_pos[:], late.mocap_quat[:] = data.mocap_pos, data.mocap_quat
    late.qacc_warmstart[:] = before.data.qacc_warmstart
    fingers = np.asarray(before.data.qpos[7:23], np.float64)
    rng = np.random.default_rng(0)
    action = [rng.uniform(-1, 1, 22) for _ in range(5)][-1]
    late.ctrl[:] = np.clip(fingers + 0.8 * action[:16], task.FINGER_LOW, task.FINGER_HIGH)
    mujoco.mj_step(model, late, env.substeps)
    np.testing.assert_allclose(obs[26:29], late.site("grasp").xpos, atol=1e-5)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_the_papers_variant_observes_the_euler_angle_of_mujocos_wrist_target(env, start_at, step, direction):
    paper, action = dataclasses.replace(env, variant="paper"), jnp.zeros(22).at[21].set(direction)
    first = state = start_at(jnp.array([0.7, 0.2]))
    for _ in range(5):
        state = step(state, action)
    sensors = jnp.tile(state.obs[26:29], 9)
    vector = np.asarray(paper.observe(state, action, state.data, sensors)[1])
    before, after = (physics.mujoco_data(env.name, data) for data in (first.data, state.data))
    target = Rotation.from_euler("XYZ", vector[26:29]).as_matrix()
    np.testing.assert_allclose(target, after.body("mocap").xmat.reshape(3, 3), atol=1e-6)
    np.testing.assert_allclose(vector[26:29], [-np.pi, 0.0, 0.1 * direction], atol=1e-5)
    turns = [after.body(body).xmat.reshape(3, 3) @ before.body(body).xmat.reshape(3, 3).T for body in ("mocap", "tool")]
    np.testing.assert_allclose(*turns, atol=0.03, err_msg="the hand follows the target")
    np.testing.assert_array_equal(np.delete(vector, [26, 27, 28]), np.delete(state.obs[:32], [26, 27, 28]))


def test_the_papers_variant_has_the_same_task(env, start_at):
    paper, rng = dataclasses.replace(env, variant="paper"), np.random.default_rng(3)
    assert (paper.obs_size, paper.state_size, paper.action_size) == (35, 32, 22)
    start = paper.start_at(jnp.array([0.7, 0.2]))
    np.testing.assert_allclose(start.obs[26:29], [-np.pi, 0.0, 0.0], atol=1e-6)
    assert not bool(paper.fault(start))
    obs = np.tile(start_at(jnp.array([0.7, 0.2])).obs, (50, 1))
    obs[:, 23:26] = rng.uniform([0.5, 0, 0.77], [0.9, 0.3, 1.1], (50, 3))
    obs[::2, 23:26] = task.TARGET + rng.uniform(-0.1, 0.1, (25, 3))
    obs[:, 26:29] = rng.uniform([0.5, 0, 0.68], [0.9, 0.3, 1.0], (50, 3))
    obs[:, 29:32] = obs[:, 26:29] - obs[:, 23:26]
    listed = obs.copy()
    listed[:, 26:29] = [-np.pi, 0.0, 0.3]
    np.testing.assert_allclose(jax.jit(paper.reward)(listed), jax.jit(env.reward)(obs), atol=1e-5)
    np.testing.assert_array_equal(paper.success(listed), env.success(obs))
    assert np.asarray(paper.success(listed)).any()
    np.testing.assert_array_equal(paper.map_position(listed), env.map_position(obs))
    experts = [jax.jit(jax.vmap(variant.expert))(rows) for variant, rows in ((paper, listed), (env, obs))]
    np.testing.assert_allclose(*experts, atol=1e-4)
    with pytest.raises(ValueError, match="reconstruction, paper"):
        make("dhand_lightbulb", variant="released")


def test_demonstrations_of_the_other_variant_are_an_error(env, start_at, tmp_path):
    tasks = {variant: dataclasses.replace(env, variant=variant) for variant in ("reconstruction", "paper")}
    for recorded, recorder in tasks.items():
        state = np.asarray(recorder.start_at(jnp.array([0.7, 0.2])).obs)
        rows = (state[None, :32], state[None, 32:], np.zeros((1, 22)), state[None, :32], np.ones(1), np.ones(1, bool))
        file = tmp_path / f"{recorded}.npz"
        demos.save({"forward": assets.Demos(*rows)}, file)
        for variant, other in tasks.items():
            reader = dataclasses.replace(other, demo_file=str(file))
            if variant == recorded:
                np.testing.assert_array_equal(reader.demos("forward").states, state[None, :32])
            else:
                with pytest.raises(ValueError, match=f"recorded with variant '{recorded}', not '{variant}'"):
                    reader.demos("forward")


def test_starts_cover_the_table_and_stay_inside(env):
    state = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(0), 500))
    bulb = np.asarray(state.obs[:, 23:26])
    assert (bulb[:, :2] >= task.START_LOW).all()
    assert (bulb[:, :2] <= task.START_HIGH).all()
    assert (np.ptp(bulb[:, :2], axis=0) > 0.97 * (task.START_HIGH - task.START_LOW)).all()
    assert np.linalg.norm(bulb - [0.7, 0.15, 0.885], axis=1).max() < 0.45
    np.testing.assert_allclose(bulb[:, 2], task.REST)
    assert np.ptp(np.asarray(state.obs[:, :23]), axis=0).max() == 0
    assert not np.asarray(jax.jit(jax.vmap(env.fault))(state)).any()
    np.testing.assert_allclose(env.initial_states[[0, -1], :2], [task.START_LOW, task.START_HIGH], rtol=1e-6)
    assert not np.asarray(state.metrics["success"]).any()


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_the_wrist_follows_its_command_within_its_range(env, start_at, direction):
    actions = jnp.zeros((40, 1, 22)).at[:, :, 16:].set(direction)
    states = run_actions(env, add_lane_axis(start_at(jnp.array([0.86, 0.3]))), actions)
    target = np.asarray(states.data.mocap_pos[:, 0, 0])
    np.testing.assert_allclose(target[0] - task.START_TARGET, 0.01 * direction, atol=1e-6)
    np.testing.assert_allclose(target[-1], task.HIGH if direction > 0 else task.LOW, atol=1e-6)
    yaw = np.asarray(jax.jit(jax.vmap(task.yaw_of))(states.data.mocap_quat[:, 0, 0]))
    assert yaw[0] == pytest.approx(0.02 * direction, abs=1e-5)
    assert yaw[-1] == pytest.approx(np.pi / 6 * direction, abs=1e-5)
    assert np.abs(np.asarray(states.data.mocap_quat)[..., [0, 3]]).max() == 0, "roll and pitch are inert"
    hand = np.asarray(states.obs[-1, 0, 26:29])
    assert np.linalg.norm(hand - (target[-1] + task.FROM_TARGET)) < 0.12, "the hand follows, turned by 30 degrees"


def documented_reward(obs):
    """Return the documented formula in float64 for one observation."""
    bulb, hand, goal = obs[23:26], obs[26:29], obs[32:35]
    distance = np.linalg.norm(bulb - goal)
    total = -np.linalg.norm(hand - bulb) - 2 * np.hypot(*(bulb - goal)[:2]) - 2 * abs(bulb[2] - goal[2])
    total -= 2.0 if hand[2] < 0.75 else 0.0
    if abs(bulb[2] - goal[2]) < 0.1:
        total += 0.9 + (0.9 if distance < 0.2 else 0.0)
    if abs(bulb[2] - goal[2]) < 0.04:
        total += 2.25 + (2.25 if distance < 0.1 else 0.0)
    return total


def test_the_reward_is_the_documented_formula(env):
    rng = np.random.default_rng(1)
    obs = np.zeros((400, 35), np.float32)
    obs[:, 23:26] = rng.uniform([0.5, 0, 0.77], [0.9, 0.3, 1.1], (400, 3))
    obs[:, 26:29] = rng.uniform([0.5, 0, 0.68], [0.9, 0.3, 1.0], (400, 3))
    obs[:, 32:] = np.where(np.arange(400)[:, None] % 2, task.TARGET, env.initial_states[np.arange(400) % 9])
    obs[::3, 23:26] = obs[::3, 32:] + rng.uniform(-0.08, 0.08, (134, 3))
    np.testing.assert_allclose(
        jax.jit(env.reward)(obs), [documented_reward(row) for row in obs.astype(np.float64)], atol=1e-5
    )
    near = np.linalg.norm(obs[:, 23:26] - obs[:, 32:], axis=1) < 0.1
    np.testing.assert_array_equal(env.success(jnp.asarray(obs)), near)
    sparse = dataclasses.replace(env, reward_type="sparse")
    np.testing.assert_array_equal(jax.jit(sparse.reward)(obs), near.astype(np.float32))


def test_the_scripted_grasp_lifts_and_holds_and_no_action_earns_the_published_return(env):
    episodes = benchmark.run_episodes(env, benchmark.start_states(env, 7, 0), 400, 0)
    held = benchmark.longest_run(episodes["success"])
    assert (held[2] >= benchmark.HOLD).all()
    assert (episodes["height"].max(axis=0)[2] > task.REST + benchmark.LIFTED).all()
    assert held[0].max() == 0
    returns = episodes["reward"].sum(axis=0)[:, 5:].mean(axis=1)
    assert -290 < returns[0] < -190
    assert -550 < returns[1] < -200
    assert 2000 < returns[2] < 2400
    assert not episodes["fault"].any()


def test_the_grasp_also_puts_the_bulb_down_at_a_goal_on_the_table(env, start_at):
    state = env.with_goal(start_at(jnp.array([0.8, 0.1])), jnp.asarray(env.initial_states[0]))

    def step(state, _):
        state = env.step(state, env.expert(state.obs))
        return state, state.obs

    last, obs = jax.jit(lambda state: jax.lax.scan(step, state, length=120))(state)
    assert bool(env.success(last.obs))
    assert float(obs[:, 25].max()) > task.REST + 0.05, "carried, not pushed"
    assert float(last.obs[25]) < task.REST + 0.02


def test_the_tether_holds_a_thrown_bulb(env, start_at):
    """The bulb starts with 3 m/s towards the edge of the table."""
    state = start_at(jnp.array([0.72, 0.15]))
    thrown = state.replace(data=state.data.replace(qvel=state.data.qvel.at[23].set(3.0).at[24].set(1.0)))
    states = run_actions(env, add_lane_axis(thrown), jnp.zeros((30, 1, 22)))
    bulb = np.asarray(states.obs[:, 0, 23:26])
    reach = np.linalg.norm(bulb - [0.7, 0.15, 0.885], axis=1)
    assert 0.4 < reach.max() < 0.5
    assert bulb[:, 2].min() > 0.74
    assert not np.asarray(jax.jit(jax.vmap(jax.vmap(env.fault)))(states)).any()


def test_fingers_pressed_onto_the_table_fold_and_do_not_penetrate_it(env, start_at):
    """Stiff fingers point straight down while the wrist moves down; without the guard, the tips end 6 cm deep."""
    actions = jnp.zeros((45, 1, 22)).at[:, :, [1, 5, 9]].set(1.0).at[15:, :, 18].set(-1.0)
    actions = actions.at[:, :, [2, 3, 6, 7, 10, 11]].set(-0.1)
    states = run_actions(env, add_lane_axis(start_at(jnp.array([0.58, 0.3]))), actions)
    pressed, target = np.asarray(states.info["pressed"][:, 0]), np.asarray(states.data.mocap_pos[:, 0, 0, 2])
    assert pressed.any()
    assert (np.diff(target)[pressed[:-1]] >= 0).all(), "the target does not go down while the fingers are pressed"
    data = physics.mujoco_data(env.name, take_lane(states.data, (-1, 0)))
    assert min(data.site(f"{finger}_tip").xpos[2] for finger in ("FF", "MF", "PF")) > task.TABLE + 0.015
    fingers = np.asarray(states.obs[:, 0, :12])
    assert (fingers > task.FINGER_LOW[:12] - 0.1).all()
    assert (fingers < task.FINGER_HIGH[:12] + 0.1).all()
