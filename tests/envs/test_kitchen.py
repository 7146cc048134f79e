"""Kitchen: the released reset, noise, observation and reward against NumPy, the paper's variant, scripts that move objects."""

import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from benchmarks.physics import kitchen as benchmark
from earl_jax import physics
from earl_jax.envs import make
from earl_jax.envs.kitchen import franka_kitchen as task, reward as kitchen_reward
from tests.envs.programs import first_state, program, run_actions, run_alone, starts

KEY = jax.random.key(3)
ENV = make("franka_kitchen")
EXACT = dataclasses.replace(ENV, noise=False)
PAPER = dataclasses.replace(EXACT, variant="paper")
MODEL = physics.load_model("franka_kitchen")
RELEASED_START = np.array(
    [0.148388023, -1.76848573, 1.84390296, -2.4768576, 0.260252026, 0.712533105, 1.59515394, 0.0479267505, 0.0371350919]
)
"""The released `init_qpos` of arm and fingers."""
PARTS = {
    "micro": {22}, "hinge": {20, 21}, "slide": {19}, "light": {17, 18}, "bottom_burner": {11, 12}, "top_burner": {15, 16}
}  # fmt: skip
"""Indices into a state of what the appliances change."""


def changed_parts(states, ignored=frozenset()):
    """Return the indices of each of `states [n, 23]` that differ from the closed kitchen."""
    return [set(np.flatnonzero(state != task.CLOSED).tolist()) - ignored for state in states]


def reward_in_numpy(obs, mocap, sites):
    """Return the released reward, component by component."""
    obs = np.asarray(obs, np.float64)
    total = -10 * np.linalg.norm(obs[9:23] - obs[32:46])
    reaching = False
    for part, site in zip([[9, 10], [11, 12], [13, 14], [15, 16], [17, 18], [19], [20, 21], [22]], sites, strict=True):
        if np.linalg.norm(obs[part] - obs[np.array(part) + 23]) < 0.01 * len(part):
            total += 1
        elif not reaching:
            reaching = True
            total -= 0.5 * np.linalg.norm(np.asarray(mocap, np.float64) - site)
    return total


def test_the_released_starts_have_two_appliances_open_and_its_time_step():
    assert ENV.simulator.timestep == pytest.approx(0.08 / 12)
    changed = {tuple(sorted(parts)) for parts in changed_parts(ENV.initial_states)}
    assert changed == {tuple(sorted(PARTS[first] | PARTS[second])) for first, second in task.PAIRS}


def test_the_variant_that_returns_to_the_mean_starts_from_all_pairs(registries):
    from benchmarks.paper.kitchen_variants import MeanReturnKitchen

    mean = MeanReturnKitchen(noise=False)
    np.testing.assert_allclose(mean.initial_states, ENV.initial_states.mean(axis=0, keepdims=True))
    np.testing.assert_array_equal(*(program(env, "reset")(KEY).obs for env in (mean, EXACT)))
    assert mean.starts.count == 6


def test_reset_is_the_state_after_ten_released_steps_of_no_action():
    model = physics.load_model("franka_kitchen", 0.002)
    joints = np.asarray(starts(EXACT).data.qpos[:, 9:])
    for lane in range(6):
        data = mujoco.MjData(model)
        data.qpos[:9] = np.clip(RELEASED_START, model.jnt_range[:9, 0], model.jnt_range[:9, 1])
        data.qpos[9:] = ENV.initial_states[lane, kitchen_reward.FIRST[9:]]
        data.mocap_pos[0], data.ctrl[:] = task.MIDDLE, RELEASED_START[:2]
        mujoco.mj_step(model, data, 400)
        np.testing.assert_allclose(data.qpos[:9], task.ARM_QPOS, atol=1e-7)
        np.testing.assert_allclose(data.qvel[:9], task.ARM_QVEL, atol=1e-6)
        np.testing.assert_allclose(data.qacc_warmstart[:9], task.ARM_WARMSTART, atol=1e-5)
        assert np.abs(joints - data.qpos[9:]).max(axis=1).min() < 1e-6, "some start is this one"
    assert np.abs(np.array(task.ARM_QPOS[:7]) - task.CLOSED[:7]).max() < 0.03, "the published arm, but for noise"


def test_weights_of_plates_and_of_the_light_close_them_slowly_as_in_the_original():
    """The original's coupled joints turn knob 1 by 0.2820 and the switch by 0.4502 mrad/s; nothing else moves by itself."""
    before = starts(EXACT, count=6)
    turned = before.data.qpos.at[:, 9].set(-0.8)
    before = before.replace(data=before.data.replace(qpos=turned))
    joints = np.asarray(run_actions(EXACT, before, np.zeros((100, 6, 9), np.float32)).data.qpos[:, :, 9:])
    speeds, lit = (joints[-1] - joints[49]) / (50 * EXACT.control_step), joints[0, :, 4] < -0.1
    assert lit.any()
    assert not lit.all()
    expected = np.zeros_like(speeds)
    expected[:, 0], expected[lit, 4] = 0.2820e-3, 0.4502e-3
    np.testing.assert_allclose(speeds, expected, rtol=0.02, atol=1e-5)


def test_noise_is_bounded_in_every_number_and_new_at_every_step():
    expected = [*[0.01] * 9, *[0.0005] * 2, *[0.00005] * 6, *[0.0005] * 3, *[0.01] * 3]
    np.testing.assert_allclose(task.NOISE, expected, rtol=1e-6)
    first = starts(ENV)
    states = run_actions(ENV, first, np.zeros((1, len(first.obs), 9), np.float32))
    after = jax.tree.map(lambda leaf: leaf[0], jax.device_get(states))
    exact = np.stack([kitchen_reward.observed(np.asarray(state.data.qpos)) for state in (first, after)])
    noise = np.stack([first.obs, after.obs])[..., :23] - exact
    assert (np.abs(noise) <= task.NOISE + 1e-6).all()
    np.testing.assert_allclose(np.abs(noise).max(axis=(0, 1)), task.NOISE, rtol=0.03, atol=1e-6)
    assert np.abs(np.corrcoef(*noise[:, :, 0])[0, 1]) < 0.2
    still = starts(EXACT)
    np.testing.assert_array_equal(still.obs[:, :23], kitchen_reward.observed(np.asarray(still.data.qpos)))


def test_observation_and_reward_match_numpy():
    """Plates and light block follow their joints, sites are those of the last substep, mocap is as commanded."""
    actions = np.sign(np.random.default_rng(0).uniform(-1, 1, (6, 9))).repeat(10, axis=0)
    states = run_alone(ENV, first_state(ENV), actions)
    joints = states.data.qpos.astype(np.float64)
    pairs = [joints[:, [9 + knob]] / [1, 174] for knob in range(4)]
    plain = np.concatenate([joints[:, :9], *pairs, joints[:, [13]] / [1, 14], joints[:, 14:]], axis=1)
    assert (np.abs(states.obs[:, :23] - plain) <= task.NOISE + 1e-5).all()
    np.testing.assert_array_equal(states.obs[:, 23:], np.tile(task.CLOSED, (60, 1)))
    mocap = np.array(task.MIDDLE)
    for move, reached in zip(actions[:, :3], states.info["mocap"], strict=True):
        mocap = np.clip(mocap + 0.02 * move, task.MOCAP_LOW, task.MOCAP_HIGH)
        np.testing.assert_allclose(reached, mocap, atol=1e-5)
    np.testing.assert_allclose([task.MOCAP_LOW, task.MOCAP_HIGH], [[-0.7, -0.1, 1.8], [0.4, 0.5, 2.6]], rtol=1e-6)
    rows = zip(states.obs, states.info["mocap"], states.info["sites"], strict=True)
    expected = [reward_in_numpy(*row) for row in rows]
    np.testing.assert_allclose(states.reward, expected, atol=1e-5)
    own = jax.jit(jax.vmap(lambda state: ENV.goal_reward(state, state.obs[:23])))(states)
    np.testing.assert_allclose(own, 8.0, atol=1e-5, err_msg="with its own state as goal, all eight parts are done")
    last = physics.mujoco_data(ENV.name, jax.tree.map(lambda leaf: leaf[-1], states.data)).site_xpos
    order = [MODEL.site(name).id for name in kitchen_reward.SITES]
    np.testing.assert_allclose(states.info["sites"][-1], last[order], atol=0.01)


def test_hand_and_handle_positions_from_joints_are_those_of_mujoco():
    rng, data = np.random.default_rng(0), mujoco.MjData(MODEL)
    flange = MODEL.eq_data[MODEL.equality("drag").id, 3:6]
    positions = jax.jit(lambda state: (kitchen_reward.site_positions(state), kitchen_reward.dragging_position(state)))
    for _ in range(5):
        data.qpos[:] = rng.uniform(*MODEL.jnt_range.T)
        mujoco.mj_forward(MODEL, data)
        sites, dragging = positions(np.float32(kitchen_reward.observed(data.qpos)))
        np.testing.assert_allclose(sites, [data.site(name).xpos for name in kitchen_reward.SITES], atol=1e-5)
        mocap = data.body("l7").xpos - data.body("mocap").xmat.reshape(3, 3) @ flange
        np.testing.assert_allclose(dragging, mocap, atol=1e-5)


def test_every_number_of_an_object_belongs_to_the_component_whose_joint_it_follows():
    components, joints = kitchen_reward.COMPONENTS, kitchen_reward.JOINT
    assert sorted(index for component in components for index in component) == list(range(9, 23))
    for component, name in zip(components, kitchen_reward.SITES, strict=True):
        own = MODEL.body_jntadr[MODEL.site(name).bodyid[0]]
        assert own in joints[[*component]]
        assert set(np.flatnonzero(joints == own)) <= {*component}


def test_the_papers_reward_and_the_sparse_reward():
    state = program(ENV, "step")(first_state(ENV), jnp.zeros(9))
    paper, sparse = dataclasses.replace(ENV, variant="paper"), dataclasses.replace(ENV, reward_type="sparse")
    batch = jnp.stack([state.obs, state.obs.at[9:23].set(state.obs[32:])])
    error = np.asarray(state.obs[:23] - state.obs[23:], np.float64)
    parts = np.split(error[9:], [2, 4, 6, 8, 10, 11, 13])
    norms = np.array([np.linalg.norm(part) for part in parts])
    expected = -np.linalg.norm(error[:9]) - norms.sum() + sum(norms < [0.01 * len(part) for part in parts])
    assert float(program(paper, "reward")(batch)[0]) == pytest.approx(expected, abs=1e-5)
    rewards = program(ENV, "reward")(batch)
    assert rewards.shape == (2,)
    assert float(rewards[0]) == pytest.approx(float(state.reward), abs=0.05), "the hand lags slightly"
    np.testing.assert_array_equal(program(ENV, "success")(batch), [False, True])
    np.testing.assert_array_equal(program(sparse, "reward")(batch), [0.0, 1.0])


def test_the_papers_variant_opens_the_appliances_of_the_text_from_a_closed_kitchen():
    assert (PAPER.observation_size, PAPER.goal_states.shape, PAPER.initial_states.shape) == (46, (11, 23), (1, 23))
    assert len(set(map(frozenset, task.TEXT_GOALS))) == 11
    changed = changed_parts(PAPER.goal_states, ignored={20})
    assert changed == [set().union(*(PARTS[name] for name in group)) - {20} for group in task.TEXT_GOALS]
    assert not PARTS["light"] & set().union(*changed), "the text has no light"
    assert {22, 21, 11, 12} in changed, "the text's example: microwave, door and burner"
    assert {11, 12, 15, 16} in changed, "two distinct burners"
    states = starts(PAPER)
    assert np.abs(states.obs[:, 9:23] - task.CLOSED[9:]).max() < 0.01, "everything is closed at the start"
    assert not np.asarray(states.metrics["success"]).any()
    assert not jax.jit(jax.vmap(PAPER.fault))(states).any()


@pytest.fixture(scope="module")
def played():
    """The positions of the objects of all scripts, and whether the last state of each is a fault."""
    moved, states = benchmark.play_all(ENV)
    return np.asarray(moved), np.asarray(jax.jit(jax.vmap(ENV.fault))(states))


@pytest.mark.parametrize(("number", "name"), enumerate(benchmark.SCRIPTS))
def test_scripts_move_each_object_to_within_015_of_its_goal(number, name, played):
    script, (moved, faults) = benchmark.SCRIPTS[name], played
    assert abs(moved[number, -1] - script.goal) < 0.15
    assert abs(moved[number, 0] - script.start) < 0.05
    assert not faults[number]


def test_six_of_nine_action_components_do_nothing_as_released():
    state, rest = first_state(EXACT), np.zeros(9, np.float32)
    step, ones = program(EXACT, "step"), np.arange(9) > 2
    after_rest = step(state, rest)
    np.testing.assert_array_equal(step(state, ones.astype(np.float32)).obs, after_rest.obs)
    up = step(state, (np.arange(9) == 2).astype(np.float32))
    np.testing.assert_allclose(up.info["mocap"] - state.info["mocap"], [0, 0, 0.02], atol=1e-6)
    assert float(after_rest.obs[7]) < float(state.obs[7]) - 0.005, "joint 1 is negative, so the left finger closes"
