"""Cheetah and fish: masses, rewards and starts alone, and all of it against dm_control if that is installed."""

import dataclasses
import importlib.util

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from benchmarks.physics.starts import settled_cheetahs
from earl_jax import assets, physics
from earl_jax.envs import make
from earl_jax.rendering.overlays import with_overlay
from tests.envs.programs import START_COUNT, first_state, program, run_actions, starts

TASKS = ("cheetah_run", "fish_swim")
CHEETAH, FISH = map(make, TASKS)
EVERY_TASK = pytest.mark.parametrize("name", TASKS)
STEPS = 100
FIELDS = """qpos0 qpos_spring jnt_type jnt_axis jnt_pos jnt_stiffness jnt_limited dof_damping dof_armature dof_invweight0
    actuator_trntype actuator_gear actuator_gainprm actuator_biasprm actuator_ctrllimited actuator_ctrlrange tendon_stiffness
    tendon_damping tendon_lengthspring wrap_type wrap_prm wrap_objid"""
BODY_FIELDS = "body_pos body_quat body_mass body_subtreemass body_ipos body_iquat body_inertia"
OPTIONS = """timestep integrator solver iterations tolerance ls_iterations ls_tolerance cone jacobian impratio gravity density
    viscosity wind disableflags enableflags"""


@pytest.fixture(scope="module")
def suite():
    """dm_control's suite, without the fields of soft bodies, which MuJoCo 4 has renamed."""
    if importlib.util.find_spec("dm_control") is None:
        pytest.skip("the extra earl-jax[suite] is not installed")
    from dm_control.mujoco.wrapper.mjbindings import sizes

    for struct, kind in (("mjmodel", mujoco.MjModel), ("mjdata", mujoco.MjData)):
        for field in [field for field in sizes.array_sizes[struct] if not hasattr(kind, field)]:
            assert field.startswith("flex")
            del sizes.array_sizes[struct][field]
    from dm_control import suite

    return suite


def test_cheetah_and_fish_have_the_masses_of_the_suite_and_visual_geoms_have_none():
    cheetah, fish = map(physics.load_model, TASKS)
    assert cheetah.body_mass.sum() == pytest.approx(14.0, abs=1e-12)
    drawn = set(range(cheetah.ngeom)) - set(cheetah.pair_geom1) - set(cheetah.pair_geom2)
    assert (cheetah.geom_group[list(drawn)] == 2).all()
    assert (cheetah.npair, cheetah.ngeom - len(drawn)) == (27, 9)
    assert fish.body_mass.sum() == pytest.approx(0.0288 + 0.00053617 + 0.00263894 + 2 * 0.00125664, rel=1e-5)


def test_cheetah_speed_and_reward_by_mujocos_own_momentum():
    obs = np.random.default_rng(0).normal(size=(60, 17)) * np.repeat([2.0, 1.0, 9.0], [2, 6, 9])
    model, data, expected = CHEETAH.simulator.mujoco_model(), mujoco.MjData(CHEETAH.simulator.mujoco_model()), []
    for row in obs:
        data.qpos[1:], data.qvel[:] = row[:8], row[8:]
        mujoco.mj_forward(model, data)
        mujoco.mj_subtreeVel(model, data)
        expected.append(data.subtree_linvel[1, 0])
    expected, rows = np.array(expected), obs.astype(np.float32)
    np.testing.assert_allclose(program(CHEETAH, "speed")(rows), expected, atol=1e-5)
    np.testing.assert_allclose(program(CHEETAH, "reward")(rows), np.clip(expected / 10, 0, 1), atol=1e-5)
    np.testing.assert_array_equal(program(CHEETAH, "success")(rows), expected >= 10)
    sparse = dataclasses.replace(CHEETAH, reward_type="sparse")
    np.testing.assert_array_equal(program(sparse, "reward")(rows), expected >= 10)
    assert 3 < (expected >= 10).sum() < 57


def test_the_settling_procedure_reproduces_the_shipped_cheetah_starts():
    shipped, settled = assets.starts("cheetah_run"), settled_cheetahs()
    assert shipped["qpos"].shape == (512, 9)
    np.testing.assert_allclose(shipped["qpos"], settled["qpos"], atol=1e-5)
    np.testing.assert_allclose(shipped["qvel"], settled["qvel"], atol=1e-4)
    data = starts(CHEETAH).data
    drawn = {tuple(row) for row in np.asarray(data.qpos).tolist()}
    assert drawn <= {tuple(row) for row in shipped["qpos"].tolist()}
    assert len(drawn) > START_COUNT / 2
    np.testing.assert_array_equal(starts(CHEETAH).obs, np.hstack([data.qpos[:, 1:], data.qvel]))


def test_crossing_the_end_of_the_lap_does_not_change_the_observation():
    start = first_state(CHEETAH)
    qpos, qvel = (np.tile(part, (2, 1)) for part in (start.data.qpos, start.data.qvel))
    qpos[:, 0], qvel[:, 0] = [0.0, 99.9], 9.0
    lanes = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), start)
    lanes = lanes.replace(data=lanes.data.replace(qpos=jnp.asarray(qpos), qvel=jnp.asarray(qvel)))
    states = run_actions(CHEETAH, lanes, np.full((5, 2, 6), 0.3, np.float32))
    np.testing.assert_allclose(states.obs[-1, 0], states.obs[-1, 1], atol=1e-4)
    middle, end = states.data.qpos[-1, :, 0].tolist()
    assert middle > 0.3
    assert -100.0 < end < -99.0


def test_fish_mouth_frame_and_reward_by_mujocos_geometry():
    model = with_overlay(FISH.name)
    mouth, target, trunk = model.geom("mouth").id, model.body("target").geomadr[0], model.body("trunk").id
    radii = model.geom_size[[mouth, target], 0].sum()
    away = 0.016 * np.arange(12)[:, None] * np.array([0.6, 0.0, 0.8])
    first = starts(FISH, count=12).replace(info={"goal": jnp.asarray(FISH.goal_states[:12])})
    actions = np.linspace(-1, 1, 60, dtype=np.float32).reshape(1, 12, 5)
    states = jax.tree.map(lambda leaf: leaf[0], jax.device_get(run_actions(FISH, first, actions)))
    np.testing.assert_array_equal(states.data.mocap_pos[:, 0], FISH.goal_states[:12], "the target is drawn at the goal")
    obs = np.hstack([states.obs[:, :33], states.obs[:, 21:24] + away]).astype(np.float32)
    values = [np.asarray(program(FISH, name)(obs)) for name in ("reward", "success", "target_seen")]
    for lane, (row, reward, success, seen) in enumerate(zip(obs, *values, strict=True)):
        data = mujoco.MjData(model)
        data.qpos[:], data.mocap_pos[:] = states.data.qpos[lane], row[33:]
        mujoco.mj_forward(model, data)
        gap, upright = data.geom_xpos[target] - data.geom_xpos[mouth], data.xmat[trunk][8]
        np.testing.assert_allclose(row[21:24], data.geom_xpos[mouth], atol=1e-6)
        np.testing.assert_allclose(row[24:33], data.geom_xmat[mouth], atol=1e-6)
        np.testing.assert_allclose(seen, gap @ data.geom_xmat[mouth].reshape(3, 3), atol=1e-6)
        assert row[7] == pytest.approx(upright, abs=1e-6)
        distance = max(np.linalg.norm(gap) - radii, 0.0) / (2 * radii)
        assert reward == pytest.approx((7 * 0.1 ** (distance**2) + (upright + 1) / 2) / 8, abs=1e-5)
        assert success == (lane < 3)
    sparse = program(dataclasses.replace(FISH, reward_type="sparse"), "reward")(obs)
    np.testing.assert_array_equal(sparse, np.arange(12) < 3)


def test_fish_starts_have_any_orientation_and_slightly_bent_joints_and_are_near_an_initial_state():
    states = starts(FISH)
    qpos = np.asarray(states.data.qpos)
    np.testing.assert_array_equal(qpos[:, :3], np.tile(np.float32([0, 0, 0.1]), (START_COUNT, 1)))
    np.testing.assert_allclose(np.linalg.norm(qpos[:, 3:7], axis=1), 1.0, rtol=1e-6)
    np.testing.assert_allclose(qpos[:, 3:7].mean(axis=0), 0.0, atol=0.1)
    np.testing.assert_allclose((qpos[:, 3:7] ** 2).mean(axis=0), 0.25, atol=0.04)
    assert np.abs(qpos[:, 7:]).max() <= 0.2
    assert np.ptp(qpos[:, 7:], axis=0).min() > 0.38
    assert not np.asarray(states.data.qvel).any()
    np.testing.assert_array_equal(states.data.mocap_pos[:, 0], states.info["goal"])
    np.testing.assert_allclose(np.linalg.norm(FISH.initial_states - [0, 0, 0.1], axis=1), 0.0745, rtol=1e-5)
    mouths = np.asarray(states.obs[:, 21:24])
    nearest = np.linalg.norm(mouths[:, None] - FISH.initial_states, axis=-1).min(axis=1)
    assert nearest.max() < 0.045, "every start is a success of some backward goal"


def test_fish_goals_cover_the_box_of_the_suite():
    goals = FISH.goal_states
    np.testing.assert_allclose([goals.min(axis=0), goals.max(axis=0)], [[-0.4, -0.4, 0.1], [0.4, 0.4, 0.3]], rtol=1e-6)
    assert len({tuple(row) for row in goals.tolist()}) == len(goals)
    points = np.random.default_rng(0).uniform([-0.4, -0.4, 0.1], [0.4, 0.4, 0.3], (2000, 3))
    assert np.linalg.norm(points[:, None] - goals, axis=-1).min(axis=1).max() < 0.0751


def load_original(suite, name, seed):
    env = suite.load(*name.split("_"), task_kwargs={"random": seed})
    env.reset()
    return env


def assert_equal_fields(actual, expected, fields, actual_part=slice(None), expected_part=slice(None)):
    for field in fields:
        values, expected_values = getattr(actual, field)[actual_part], getattr(expected, field)[expected_part]
        np.testing.assert_allclose(values, expected_values, rtol=1e-12, atol=1e-15, err_msg=field)


@EVERY_TASK
def test_the_compiled_model_is_the_suites(suite, name):
    original, ours = load_original(suite, name, 0).physics.model.ptr, physics.load_model(name)
    assert_equal_fields(ours, original, FIELDS.split())
    bodies = slice(ours.nbody - original.nbody + 1, None)
    assert_equal_fields(ours, original, BODY_FIELDS.split(), bodies, slice(1, None))
    for option in OPTIONS.split():
        np.testing.assert_array_equal(getattr(ours.opt, option), getattr(original.opt, option), err_msg=option)
    if name == "cheetah_run":
        np.testing.assert_array_equal(ours.jnt_range, original.jnt_range)
    else:
        assert not original.jnt_limited.any(), "ranges of joints without limits have no effect, so ours has none"


@EVERY_TASK
@pytest.mark.parametrize("seed", range(3))
def test_a_hundred_steps_equal_those_of_dm_control(suite, name, seed):
    """The same start and actions give the same joints, observations and rewards, step by step and over the whole run.

    From the original's own state, a step differs by one rounding to float32: 1e-6 of the fastest joint. Over the run (1 s or
    4 s), contacts amplify rounding errors. The largest error seen is 4e-6; 1e-5 leaves room for other compilers.
    """
    env, original = make(name), load_original(suite, name, seed)
    data, start = original.physics.data, env.reset(jax.random.key(seed))
    if name == "fish_swim":
        start = env.with_goal(start, jnp.asarray(original.physics.named.model.geom_pos["target"], jnp.float32))

    def original_layout(obs):
        return obs if name == "cheetah_run" else np.concatenate([obs[:8], env.target_seen(obs), obs[8:21]])

    def with_original_data(state):
        fields = ("qpos", "qvel", "qacc_warmstart")
        return state.replace(data=state.data.replace(**{f: jnp.asarray(getattr(data, f), jnp.float32) for f in fields}))

    state, step = with_original_data(start), program(env, "step")
    for action in np.random.default_rng(seed).uniform(-1, 1, (STEPS, env.action_size)).astype(np.float32):
        single, state, expected = step(with_original_data(state), action), step(state, action), original.step(action)
        expected_obs = np.concatenate([np.atleast_1d(part) for part in expected.observation.values()])
        for actual, tolerance in ((single, 1e-6 * max(np.abs(data.qvel).max(), 1.0)), (state, 1e-5)):
            np.testing.assert_allclose(actual.data.qpos, data.qpos, atol=tolerance)
            np.testing.assert_allclose(actual.data.qvel, data.qvel, atol=tolerance)
            np.testing.assert_allclose(original_layout(actual.obs), expected_obs, atol=tolerance)
            assert float(actual.reward) == pytest.approx(expected.reward, abs=1e-6)
