"""Sawyer door and peg: numbers as released, starts, rewards, demonstrations, experts, and long reset-free use."""

import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from benchmarks.physics import replay_demos
from earl_jax import assets, physics
from earl_jax.demos import scripted
from earl_jax.envs import make
from earl_jax.envs.sawyer.base import _pulled_target
from earl_jax.envs.sawyer.door import AT_HANDLE, handle_at
from earl_jax.envs.sawyer.door import HOME as DOOR_HOME
from earl_jax.envs.sawyer.peg import HEADS
from earl_jax.envs.sawyer.peg import HOME as PEG_HOME

TASKS = ("sawyer_door", "sawyer_peg")
RECORDED = Path(__file__).parents[3] / "shared" / "reference_demos"
EVERY_TASK = pytest.mark.parametrize("name", TASKS)


@pytest.fixture(scope="module")
def door():
    return make("sawyer_door", engine="c")


@pytest.fixture(scope="module")
def peg():
    return make("sawyer_peg", engine="c")


def starts(env, count=300):
    return jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(0), count))


@pytest.mark.parametrize(
    ("name", "pose"), [("sawyer_door", DOOR_HOME), ("sawyer_door", AT_HANDLE), ("sawyer_peg", PEG_HOME)]
)
def test_the_observed_reset_pose_agrees_with_its_joints(name, pose):
    env = make(name, reset_at_goal=pose is AT_HANDLE)
    data = physics.mujoco_data(name, env.reset(jax.random.key(0)).data)
    hand, right, left = data.sensordata[:9].reshape(3, 3)
    np.testing.assert_allclose(hand, pose.hand, atol=1e-6)
    assert np.clip(np.linalg.norm(right - left) / 0.1, 0, 1) == pytest.approx(pose.grip, abs=1e-5)


def test_door_starts_cover_the_released_angles(door):
    state = starts(door)
    angle = np.asarray(state.data.qpos[:, 9])
    assert -np.pi / 3 <= angle.min() < -1.04
    assert -0.9 < angle.max() <= -np.pi / 3 + np.pi / 20
    np.testing.assert_allclose(handle_at(jnp.array(-np.pi / 3)), door.initial_states[0, 4:], atol=1e-6)
    np.testing.assert_allclose(handle_at(jnp.array(0.0)), door.goal_states[0, 4:], atol=1e-6)
    np.testing.assert_allclose(np.asarray(state.obs[:, 4:7]), jax.vmap(handle_at)(state.data.qpos[:, 9]), atol=1e-6)
    still = starts(dataclasses.replace(door, door_noise=False))
    np.testing.assert_allclose(still.data.qpos[:, 9], -np.pi / 3, rtol=1e-6)
    closed = starts(dataclasses.replace(door, reset_at_goal=True))
    assert (np.asarray(closed.data.qpos[:, 9]) >= -np.pi / 20).all()
    np.testing.assert_allclose(closed.info["goal"], np.tile(door.initial_states, (300, 1)))


def test_peg_starts_cover_the_released_positions(peg):
    middle = np.asarray(starts(peg).data.qpos[:, 9:])
    assert (middle.min(axis=0) >= [0.0, 0.5, 0.0199]).all()
    assert (middle.max(axis=0) <= [0.2, 0.7, 0.0201]).all()
    assert np.ptp(middle, axis=0)[:2].min() > 0.18
    listed = np.asarray(starts(dataclasses.replace(peg, listed=True)).obs[:, 4:6])
    assert {tuple(row) for row in listed.round(5).tolist()} == {tuple(row) for row in HEADS.round(5).tolist()}
    wide = np.asarray(starts(dataclasses.replace(peg, wide=True)).data.qpos[:, 9:])
    assert 0.35 < np.mean((wide[:, 0] >= 0) & (wide[:, 0] <= 0.2) & (wide[:, 1] >= 0.5) & (wide[:, 1] <= 0.7)) < 0.65
    inserted = np.asarray(starts(dataclasses.replace(peg, reset_at_goal=True)).obs[:, 4:7])
    assert np.abs(inserted - peg.goal_states[0, 4:]).max() <= 0.02 + 1e-6
    with pytest.raises(ValueError, match="choose one"):
        make("sawyer_peg", wide=True, listed=True)


@EVERY_TASK
def test_the_papers_variant_has_twelve_numbers_and_its_own_radius(name):
    env, released = make(name, variant="paper"), make(name)
    state, full = env.reset(jax.random.key(1)), released.reset(jax.random.key(1))
    observed = np.delete(np.arange(14), [3, 10])
    np.testing.assert_array_equal(state.obs, full.obs[observed])
    assert env.radius["paper"] == {"sawyer_door": 0.08, "sawyer_peg": 0.05}[name]
    assert env.demos("forward").states.shape[1] == 6
    near = jnp.asarray(np.concatenate([env.goal_states[0] + [0, 0, 0, 0.045, 0, 0], env.goal_states[0]]), jnp.float32)
    assert bool(env.success(near))
    with pytest.raises(ValueError, match="released, paper"):
        make(name, variant="other")


def test_the_experts_of_the_papers_variant(door, peg):
    paper_door, paper_peg = (dataclasses.replace(env, variant="paper") for env in (door, peg))
    states = [env.reset(jax.random.key(1)) for env in (door, paper_door)]
    np.testing.assert_array_equal(door.expert(states[0].obs), paper_door.expert(states[1].obs))
    with pytest.raises(ValueError, match="which variant 'paper' omits"):
        paper_peg.expert(paper_peg.reset(jax.random.key(1)).obs)


@EVERY_TASK
@pytest.mark.parametrize("grip", [1.0, -1.0, 0.5])
def test_the_grippers_action_is_a_normalized_force_to_within_16_newtons(name, grip):
    """The paper's text calls it a torque; the released actuators set a position, and a finger moves by 4 cm at most."""
    env = make(name, engine="c")
    model = physics.load_model(name)
    state = env.reset(jax.random.key(0))
    data = physics.mujoco_data(name, state.data)
    for opening in (0.0, 0.5, 1.0):
        data.qpos[7:9] = [0.04 * opening, -0.03 * opening]
        data.ctrl[:] = env.control(state, jnp.array([0.0, 0.0, 0.0, grip]))[1]
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(data.actuator_force, [400 * grip, -400 * grip], atol=16.01)
    assert np.abs(data.actuator_force - [400 * grip, -400 * grip]).max() > 15.9


def test_door_dense_reward_by_hand(door):
    env = dataclasses.replace(door, reward_type="dense")
    obs = np.asarray(env.reset(jax.random.key(2)).obs, np.float64)
    hand, handle, goal = obs[:3], obs[4:7], obs[11:14]
    reach, left = np.linalg.norm(hand - handle), np.linalg.norm(handle - goal)

    def bell(distance, free, margin):
        return 0.1 ** ((max(distance - free, 0.0) / margin) ** 2)

    near = bell(reach, 0.0125, np.linalg.norm(np.array([0, 0.4, 0.2]) - handle) + 0.1)
    placed = bell(left, 0.05, np.linalg.norm(np.array([0.1, 0.95, 0.1]) - goal))
    assert float(env.reward(jnp.asarray(obs, jnp.float32))) == pytest.approx(3 * near + 6 * placed, rel=1e-4)
    assert float(env.reward(jnp.asarray(np.r_[obs[:4], goal, obs[7:]], jnp.float32))) == 10.0


def test_peg_dense_reward_rises_along_a_demonstration_and_ends_at_ten(peg):
    env = dataclasses.replace(peg, reward_type="dense")
    demos = assets.demos("sawyer_peg", "forward")
    actions = jnp.asarray(demos.actions[: np.flatnonzero(demos.ends)[0] + 1])
    state = replay_demos.start_state(env, np.hstack([demos.states[0], demos.goals[0]]))

    def step(state, action):
        state = env.step(state, action)
        return state, state.reward

    rewards = np.asarray(jax.lax.scan(step, state, actions)[1])
    thirds = [part.mean() for part in np.array_split(rewards[:-5], 3)]
    assert thirds[0] < thirds[1] < thirds[2]
    assert 0 <= rewards.min() < 0.1
    assert 1.0 < rewards[-10:].max() <= 10.0


def test_goal_reward_is_the_reward_under_the_given_goal(peg):
    env = dataclasses.replace(peg, reward_type="dense")
    state = env.step(env.reset(jax.random.key(0)), jnp.zeros(4))
    assert float(env.goal_reward(state, state.info["goal"])) == pytest.approx(float(state.reward))
    own_state = state.obs[:7]
    assert float(env.goal_reward(state, own_state)) == 10.0


def test_the_door_expert_closes_and_opens_again_without_a_reset(door):
    """The task of a reset-free agent, ten times in a row."""

    def phase(state, goal):
        def step(carry, _):
            state, success = carry
            state = door.step(state, door.expert(state.obs))
            return (state, success | door.success(state.obs)), None

        return jax.lax.scan(step, (door.with_goal(state, goal), jnp.zeros((), bool)), length=door.eval_horizon)[0]

    state, goals = door.reset(jax.random.key(0)), jnp.asarray([door.goal_states[0], door.initial_states[0]])
    run = jax.jit(lambda s: jax.lax.scan(phase, s, jnp.tile(goals, (5, 1))))
    assert np.asarray(run(state)[1]).sum() >= 9


@EVERY_TASK
@pytest.mark.parametrize("direction", assets.DIRECTIONS)
def test_shipped_demonstrations_end_in_success(name, direction):
    env, demos = make(name), assets.demos(name, direction)
    assert demos.ends.sum() == {"sawyer_door": 5, "sawyer_peg": 10}[name]
    np.testing.assert_array_equal(demos.rewards > 0, demos.ends)
    success = np.asarray(env.success(jnp.asarray(np.hstack([demos.next_states, demos.goals]))))
    np.testing.assert_array_equal(success, demos.ends)
    targets = env.goal_states if direction == "forward" else env.initial_states
    assert all((np.abs(targets - goal).max(axis=1) < 1e-6).any() for goal in demos.goals)
    assert np.abs(demos.actions).max() <= 1.0


@EVERY_TASK
def test_the_demonstration_script_reproduces_the_shipped_demonstrations(name):
    recorded = scripted.make(make(name, engine="c"))
    for direction, demos in recorded.items():
        shipped = assets.demos(name, direction)
        assert demos.ends.sum() == shipped.ends.sum()
        first = np.flatnonzero(shipped.ends)[0]
        np.testing.assert_allclose(demos.states[: first // 2], shipped.states[: first // 2], atol=1e-3)


@EVERY_TASK
def test_replayed_demonstrations_on_c_reach_their_goals(name, tmp_path):
    demos = assets.demos(name, "forward")
    np.savez(
        tmp_path / "own.npz",
        observations=np.hstack([demos.states, demos.goals]),
        actions=demos.actions,
        rewards=demos.rewards,
        next_observations=np.hstack([demos.next_states, demos.goals]),
        terminals=demos.ends,
    )
    own = replay_demos.replay(name, tmp_path / "own.npz", "c")
    assert own["successes_within_hold"] == own["episodes"]
    assert own["mean_object_error_mm"] < 1.0


@pytest.mark.skipif(not RECORDED.is_dir(), reason="the authors' recordings are not part of the project")
@EVERY_TASK
def test_the_authors_recordings_replayed_on_c_reach_their_goals(name):
    theirs = replay_demos.replay(name, RECORDED / f"{name}_forward.npz", "c")
    assert theirs["successes_within_hold"] == theirs["episodes"] == {"sawyer_door": 5, "sawyer_peg": 10}[name]
    assert theirs["mean_object_error_mm"] <= {"sawyer_door": 10, "sawyer_peg": 4}[name]
    assert theirs["reward_agreement"] >= 0.97
    assert theirs["reset_arm_error"] <= 1e-6


def test_a_hand_that_slips_off_does_not_get_too_fast(door):
    """The target is half a metre ahead of a free hand, which reaches 9 m/s in the original."""
    state = door.reset(jax.random.key(0))
    far = state.replace(data=state.data.replace(mocap_pos=state.data.mocap_pos + jnp.array([0.0, 0.5, 0.25])))

    def step(state, action):
        state = door.step(state, action)
        return state, state.obs[:3]

    _, hands = jax.lax.scan(step, far, jnp.zeros((60, 4)))
    speed = np.linalg.norm(np.diff(np.asarray(hands), axis=0), axis=1) / door.control_step
    assert 1.5 < speed.max() < 4.5
    assert np.linalg.norm(hands[-1] - far.data.mocap_pos[0]) < 0.1, "the hand arrives, as near as the arm can reach"
    near = state.obs[:3] + jnp.array([0.0, 0.3, 0.2])
    np.testing.assert_array_equal(_pulled_target(state, near), near)
