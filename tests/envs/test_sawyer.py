"""Sawyer door and peg: starts, variants, rewards, the gripper, experts, and replayed demonstrations."""

import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from benchmarks.physics import replay_demos
from earl_jax import assets, physics
from earl_jax.envs import HelpBudget, make
from earl_jax.envs.demos import save
from earl_jax.envs.mujoco_env import leashed_target
from earl_jax.envs.sawyer.door import handle_at
from earl_jax.envs.sawyer.peg import HEADS
from tests.envs.programs import first_state, program, run_actions, run_alone, starts

TASKS = ("sawyer_door", "sawyer_peg")
DOOR, PEG = map(make, TASKS)
RECORDED = Path(__file__).parents[3] / "shared" / "reference_demos"
EVERY_POSE = pytest.mark.parametrize("env", [DOOR, dataclasses.replace(DOOR, reset_at_goal=True), PEG])
EVERY_TASK = pytest.mark.parametrize("name", TASKS)


@EVERY_POSE
def test_the_observed_reset_pose_agrees_with_its_joints(env):
    hand, right, left = physics.mujoco_data(env.name, first_state(env).data).sensordata[:9].reshape(3, 3)
    np.testing.assert_allclose(hand, env.pose.hand, atol=1e-6)
    assert np.clip(np.linalg.norm(right - left) / 0.1, 0, 1) == pytest.approx(env.pose.grip, abs=1e-5)


@EVERY_POSE
def test_the_reset_pose_is_where_250_substeps_lead_the_arm(env):
    """The released poses come from an older MuJoCo: they differ from ours by up to 0.014 rad and 0.15 rad/s."""
    reset = physics.mujoco_data(env.name, first_state(env).data)
    settled = mujoco.MjData(reset.model)
    settled.mocap_pos[:], settled.mocap_quat[:], settled.ctrl[:] = env.pose.target, reset.mocap_quat, (-1, 1)
    mujoco.mj_step(reset.model, settled, nstep=250)
    np.testing.assert_allclose(env.pose.qpos, settled.qpos[:9], atol=0.02)
    np.testing.assert_allclose(env.pose.qvel, settled.qvel[:9], atol=0.2)


def test_door_starts_cover_the_released_angles():
    state = starts(DOOR)
    angle = np.asarray(state.data.qpos[:, 9])
    assert -np.pi / 3 <= angle.min() < -1.04
    assert -0.892 < angle.max() <= -np.pi / 3 + np.pi / 20
    expected = np.vstack([DOOR.initial_states[0, 4:], DOOR.goal_states[0, 4:], state.obs[:, 4:7]])
    handles = jax.jit(jax.vmap(handle_at))(np.float32([-np.pi / 3, 0.0, *angle]))
    np.testing.assert_allclose(handles, expected, atol=1e-6)
    still = first_state(dataclasses.replace(DOOR, door_noise=False))
    np.testing.assert_allclose(still.data.qpos[9], -np.pi / 3, rtol=1e-6)
    closed = starts(dataclasses.replace(DOOR, reset_at_goal=True))
    assert (np.asarray(closed.data.qpos[:, 9]) >= -np.pi / 20).all()


def test_peg_starts_cover_the_released_positions():
    middle = np.asarray(starts(PEG).data.qpos[:, 9:])
    assert (middle.min(axis=0) >= [0.0, 0.5, 0.0199]).all()
    assert (middle.max(axis=0) <= [0.2, 0.7, 0.0201]).all()
    assert np.ptp(middle, axis=0)[:2].min() > 0.18
    listed = np.asarray(starts(make("sawyer_peg", listed=True)).obs[:, 4:6])
    assert {tuple(row) for row in listed.round(5).tolist()} == {tuple(row) for row in HEADS.round(5).tolist()}
    wide = np.asarray(starts(make("sawyer_peg", wide=True)).data.qpos[:, 9:11])
    assert 0.35 < ((wide >= [0.0, 0.5]) & (wide <= [0.2, 0.7])).all(axis=1).mean() < 0.65
    assert (wide >= [-0.32, 0.34]).all()
    assert (wide <= [0.27, 0.92]).all()
    inserted = np.asarray(starts(make("sawyer_peg", reset_at_goal=True)).obs[:, 4:7])
    assert np.abs(inserted - PEG.goal_states[0, 4:]).max() <= 0.02 + 1e-6
    with pytest.raises(ValueError, match="choose one"):
        make("sawyer_peg", wide=True, listed=True)


@pytest.mark.parametrize("released", [DOOR, PEG])
def test_a_task_that_starts_at_its_goal_has_the_released_starts_as_goals_at_every_draw(released):
    env = dataclasses.replace(released, reset_at_goal=True)
    np.testing.assert_array_equal(env.goal_states, released.initial_states)
    np.testing.assert_array_equal(env.initial_states, released.goal_states)
    at_reset, drawn = starts(env).info["goal"], starts(env, "sample_goal")
    assert set(map(tuple, at_reset.tolist())) == set(map(tuple, drawn.tolist()))
    assert env.map.goals is None or not (env.map.goals == env.map.starts).any()
    assert env.demonstrations.directions == released.demonstrations.directions
    recorded = released.demonstrations.load("backward")
    np.testing.assert_array_equal(env.demonstrations.load("forward").states, recorded.states)
    forward = next(iter(env.demonstrations.script.starts(0))).forward
    np.testing.assert_array_equal(forward.info["goal"], released.goal_states[0])
    assert not env.success(forward.obs)
    helped = HelpBudget(env, 2.0).demonstrations.load("forward")
    np.testing.assert_array_equal(helped.actions[:, :-1], recorded.actions)


def test_the_dense_reward_of_a_pegs_start_counts_the_fingers_around_it_as_a_step_at_rest_does():
    env = make("sawyer_peg", reward_type="dense")
    state = starts(env)
    still = jnp.broadcast_to(jnp.array([0.0, 0.0, 0.0, -1.0]), (len(state.reward), 4))
    after = np.asarray(jax.jit(jax.vmap(env.step))(state, still).reward)
    np.testing.assert_allclose(state.reward, after, atol=0.01)
    assert np.asarray(state.reward).mean() == pytest.approx(after.mean(), rel=0.05)


@pytest.mark.parametrize("option", ["listed", "wide"])
def test_backward_demonstrations_start_inserted_whatever_the_tasks_starts(option):
    start = next(iter(make("sawyer_peg", **{option: True}).demonstrations.script.starts(0)))
    assert np.abs(start.backward.obs[4:7] - PEG.goal_states[0, 4:]).max() <= 0.02 + 1e-6


@pytest.mark.parametrize(("released", "radii"), [(DOOR, (0.02, 0.08)), (PEG, (0.05, 0.05))])
def test_the_papers_variant_has_twelve_numbers_and_its_own_radius(released, radii, tmp_path):
    env = dataclasses.replace(released, variant="paper")
    assert (released.radius["released"], env.radius["paper"]) == radii
    assert (released.observation_size, env.observation_size) == (14, 12)
    state, full = first_state(env), first_state(released)
    np.testing.assert_array_equal(state.obs, np.delete(full.obs, [3, 10]))
    demos = env.demonstrations.load("forward")
    assert demos.states.shape[1] == 6
    save({"forward": demos}, tmp_path / "own.npz")
    own = dataclasses.replace(env, demo_file=str(tmp_path / "own.npz")).demonstrations.load("forward")
    np.testing.assert_array_equal(own.states, demos.states, err_msg="those that the variant recorded are its own")
    near = np.concatenate([env.goal_states[0] + np.float32([0, 0, 0, 0.045, 0, 0]), env.goal_states[0]])
    assert env.success(near)
    if env.name == "sawyer_door":
        experts = released.demonstrations.expert, env.demonstrations.expert
        np.testing.assert_array_equal(experts[0](full.obs), experts[1](state.obs))
    else:
        assert (env.demonstrations.expert, env.demonstrations.script) == (None, None)


@EVERY_TASK
@pytest.mark.parametrize("grip", [1.0, -1.0, 0.5])
def test_the_grippers_action_is_a_normalized_force_to_within_16_newtons(name, grip):
    """The paper's text calls it a torque; the released actuators set a position, and a finger moves by 4 cm at most."""
    env, model = make(name), physics.load_model(name)
    state = first_state(env)
    data = physics.mujoco_data(name, state.data)
    for opening in (0.0, 0.5, 1.0):
        data.qpos[7:9] = [0.04 * opening, -0.03 * opening]
        data.ctrl[:] = program(env, "control")(state, jnp.array([0.0, 0.0, 0.0, grip]))[1]
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(data.actuator_force, [400 * grip, -400 * grip], atol=16.01)
    assert np.abs(data.actuator_force - [400 * grip, -400 * grip]).max() > 15.9


@EVERY_TASK
def test_the_target_of_the_hand_stays_in_its_workspace(name):
    actions = np.zeros((80, 2, 4), np.float32)
    actions[:, :, :3] = [[1.0], [-1.0]]
    targets = run_actions(make(name), starts(make(name), count=2), actions).data.mocap_pos[-1, :, 0]
    np.testing.assert_array_equal(targets, np.float32([[0.5, 1.0, 0.5], [-0.5, 0.4, 0.05]]))


def test_door_dense_reward_by_hand():
    obs = np.asarray(first_state(DOOR).obs, np.float64)
    hand, handle, goal = obs[:3], obs[4:7], obs[11:14]
    reach, left = np.linalg.norm(hand - handle), np.linalg.norm(handle - goal)

    def bell(distance, free, margin):
        return 0.1 ** ((max(distance - free, 0.0) / margin) ** 2)

    near = bell(reach, 0.0125, np.linalg.norm(np.array([0, 0.4, 0.2]) - handle) + 0.1)
    placed = bell(left, 0.05, np.linalg.norm(np.array([0.1, 0.95, 0.1]) - goal))
    reward = program(dataclasses.replace(DOOR, reward_type="dense"), "reward")
    rewards = reward(np.stack([obs, np.r_[obs[:4], goal, obs[7:]]]).astype(np.float32))
    np.testing.assert_allclose(rewards, [3 * near + 6 * placed, 10.0], rtol=1e-4)


def test_peg_dense_reward_rises_along_a_demonstration_ends_at_ten_and_is_that_of_any_goal():
    env, demos = dataclasses.replace(PEG, reward_type="dense"), assets.demos("sawyer_peg", "forward")
    actions = demos.actions[: np.flatnonzero(demos.ends)[0] + 1]
    state = replay_demos.start_state(env, np.hstack([demos.states[0], demos.goals[0]]))
    states = run_alone(env, state, actions)
    rewards = states.reward
    thirds = [part.mean() for part in np.array_split(rewards[:-5], 3)]
    assert thirds[0] < thirds[1] < thirds[2]
    assert 0 <= rewards.min() < 0.1
    assert 1.0 < rewards[-10:].max() <= 10.0
    last = jax.tree.map(lambda leaf: leaf[-1], states)
    goal_reward = program(env, "goal_reward")
    assert goal_reward(last, last.info["goal"]) == pytest.approx(rewards[-1])
    assert goal_reward(last, last.obs[:7]) == 10.0


def test_the_pegs_dense_reward_counts_distances_across_the_hole_twice():
    env = dataclasses.replace(PEG, reward_type="dense")
    heads = PEG.goal_states[0, 4:] + np.float32([[0.04, 0, 0], [0, 0.04, 0], [0, 0, 0.04], [0.06, 0, 0]])
    obs = np.hstack([np.tile(PEG.goal_states[0, :4], (4, 1)), heads, np.tile(PEG.goal_states[0], (4, 1))])
    np.testing.assert_array_equal(program(env, "reward")(obs) == 10.0, [True, False, False, False])


@pytest.mark.skipif(not RECORDED.is_dir(), reason="the authors' recordings are not part of the project")
@pytest.mark.parametrize(("name", "episodes", "error"), [("sawyer_door", 5, 10), ("sawyer_peg", 10, 4)])
def test_the_authors_recordings_replayed_on_c_reach_their_goals(name, episodes, error):
    theirs = replay_demos.replay(name, RECORDED / f"{name}_forward.npz", "c")
    assert theirs["successes_within_hold"] == theirs["episodes"] == episodes
    assert theirs["mean_object_error_mm"] <= error
    assert theirs["reward_agreement"] >= 0.97
    assert theirs["reset_arm_error"] <= 1e-6


@pytest.mark.parametrize("fastest", [0.0, 2.5, 9.0])
def test_a_target_leads_the_hand_by_a_length_that_depends_on_the_fastest_joint(fastest):
    speeds, lengths = np.float32([[1.0, 4.0], [0.2, 0.08]])
    hand, length = np.array([0.1, 0.5, 0.0], np.float32), np.interp(fastest, speeds, lengths)
    far, near = hand + np.float32([0.9, 0, 0]), hand + np.float32([0.5 * length, 0, 0])
    pulled, left = (leashed_target(target, hand, np.float32(fastest), speeds, lengths) for target in (far, near))
    np.testing.assert_allclose(pulled, hand + np.array([length, 0, 0]), atol=1e-6)
    np.testing.assert_array_equal(left, near)


def test_a_hand_that_slips_off_does_not_get_too_fast():
    """The target is half a metre ahead of a free hand, which reaches 9 m/s in the original."""
    state = first_state(DOOR)
    far = state.replace(data=state.data.replace(mocap_pos=state.data.mocap_pos + jnp.array([0.0, 0.5, 0.25])))
    hands = run_alone(DOOR, far, np.zeros((60, 4))).obs[:, :3]
    speed = np.linalg.norm(np.diff(hands, axis=0), axis=1) / DOOR.control_step
    assert 1.5 < speed.max() < 4.5
    assert np.linalg.norm(hands[-1] - far.data.mocap_pos[0]) < 0.1, "the hand arrives, as near as the arm can reach"
