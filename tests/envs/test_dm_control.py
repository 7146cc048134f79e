"""Cheetah and fish: numbers, rewards and starts by themselves, and all of it against dm_control where that is installed."""

import dataclasses
import importlib.util
import itertools

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from earl_jax import assets, physics
from earl_jax.envs import make
from earl_jax.envs.dm_control.cheetah_run import settle

TASKS = ("cheetah_run", "fish_swim")
EVERY = pytest.mark.parametrize("name", TASKS)
STEPS = 100
FIELDS = """qpos0 qpos_spring jnt_type jnt_axis jnt_pos jnt_stiffness jnt_limited dof_damping dof_armature dof_invweight0
    actuator_trntype actuator_gear actuator_gainprm actuator_biasprm actuator_ctrllimited actuator_ctrlrange tendon_stiffness
    tendon_damping tendon_lengthspring wrap_type wrap_prm wrap_objid"""
BODY_FIELDS = "body_pos body_quat body_mass body_subtreemass body_ipos body_iquat body_inertia"
OPTIONS = """timestep integrator solver iterations tolerance ls_iterations ls_tolerance cone jacobian impratio gravity density
    viscosity wind disableflags enableflags"""


@pytest.fixture(scope="module")
def cheetah():
    return make("cheetah_run", physics="c")


@pytest.fixture(scope="module")
def fish():
    return make("fish_swim", physics="c")


def state_from_demo(env, count):
    return jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(0), count))


@pytest.fixture(scope="module")
def shoal(fish):
    return state_from_demo(fish, 500)


@pytest.fixture(scope="module")
def suite():
    """The suite itself. It looks up fields that MuJoCo 4 has renamed; they belong to soft bodies, which it can do without."""
    if importlib.util.find_spec("dm_control") is None:
        pytest.skip("the extra earl-jax[suite] is not installed: nothing to compare with")
    from dm_control.mujoco.wrapper.mjbindings import sizes

    for struct, kind in (("mjmodel", mujoco.MjModel), ("mjdata", mujoco.MjData)):
        for field in [field for field in sizes.array_sizes[struct] if not hasattr(kind, field)]:
            assert field.startswith("flex")
            del sizes.array_sizes[struct][field]
    from dm_control import suite

    return suite


def test_numbers_of_the_tasks(cheetah, fish):
    sizes = {"cheetah_run": (17, 0, 6, 0.01, 1, 0.01), "fish_swim": (33, 3, 5, 0.04, 10, 0.004)}
    for env in (cheetah, fish):
        own, used = (model.opt.timestep for model in (physics.load_model(env.name), env.simulator.mujoco_model()))
        found = (env.state_size, env.goal_size, env.action_size, env.control_step, env.substeps, own)
        assert found == pytest.approx(sizes[env.name])
        assert used == pytest.approx(own)
        assert (env.reward_type, env.eval_horizon, env.train_horizon) == ("dense", 1000, 100_000)
    assert cheetah.goal_states.shape == cheetah.initial_states.shape == (1, 0)


def test_cheetah_and_fish_weigh_what_the_suites_do_and_what_is_drawn_on_them_nothing():
    cheetah, fish = map(physics.load_model, TASKS)
    assert cheetah.body_mass.sum() == pytest.approx(14.0, abs=1e-12)
    drawn = set(range(cheetah.ngeom)) - set(cheetah.pair_geom1) - set(cheetah.pair_geom2)
    assert (cheetah.geom_group[list(drawn)] == 2).all()
    assert (cheetah.npair, cheetah.ngeom - len(drawn)) == (27, 9)
    assert fish.body_mass.sum() == pytest.approx(0.0288 + 0.00053617 + 0.00263894 + 2 * 0.00125664, rel=1e-5)


def test_cheetah_speed_and_reward_by_mujocos_own_momentum(cheetah):
    obs = np.random.default_rng(0).normal(size=(60, 17)) * np.repeat([2.0, 1.0, 9.0], [2, 6, 9])
    model, sparse = cheetah.simulator.mujoco_model(), dataclasses.replace(cheetah, reward_type="sparse")
    asked = (cheetah.speed, cheetah.reward, cheetah.success, sparse.reward)
    found = [np.asarray(function(jnp.asarray(obs, jnp.float32))) for function in asked]
    data = mujoco.MjData(model)
    for row, (speed, reward, success, bit) in zip(obs, zip(*found, strict=True), strict=True):
        data.qpos[1:], data.qvel[:] = row[:8], row[8:]
        mujoco.mj_forward(model, data)
        mujoco.mj_subtreeVel(model, data)
        wanted = data.subtree_linvel[1, 0]
        assert speed == pytest.approx(wanted, abs=1e-5)
        assert reward == pytest.approx(np.clip(wanted / 10, 0, 1), abs=1e-5)
        assert success == bit == (wanted >= 10)
    assert 3 < found[2].sum() < 57


def test_cheetah_starts_are_those_that_the_procedure_settles(cheetah):
    shipped, made = assets.starts("cheetah_run"), settle()
    assert shipped["qpos"].shape == (512, 9)
    np.testing.assert_allclose(shipped["qpos"], made["qpos"], atol=1e-5)
    np.testing.assert_allclose(shipped["qvel"], made["qvel"], atol=1e-4)
    states = state_from_demo(cheetah, 300)
    rows = {tuple(row) for row in shipped["qpos"].tolist()}
    drawn = {tuple(row) for row in np.asarray(states.data.qpos).tolist()}
    assert drawn <= rows
    assert len(drawn) > 150
    np.testing.assert_array_equal(states.obs, np.hstack([states.data.qpos[:, 1:], states.data.qvel]))
    with pytest.raises(ValueError, match=r"no starts for 'fish_swim'; choose from .*cheetah_run"):
        assets.starts("fish_swim")


def test_the_track_is_a_lap_that_nobody_notices(cheetah):
    start = cheetah.reset(jax.random.key(0))
    step = jax.jit(cheetah.step)

    def run(ahead):
        qvel = start.data.qvel.at[0].set(9.0)
        state = start.replace(data=start.data.replace(qpos=start.data.qpos.at[0].set(ahead), qvel=qvel))
        for _ in range(5):
            state = step(state, jnp.full(6, 0.3))
        return state

    here, over = run(0.0), run(99.9)
    np.testing.assert_allclose(here.obs, over.obs, atol=1e-4)
    assert float(here.data.qpos[0]) > 0.3
    assert -100.0 < float(over.data.qpos[0]) < -99.0


def test_fish_mouth_frame_and_reward_by_mujocos_geometry(fish, shoal):
    model = fish.simulator.mujoco_model()
    mouth, target, trunk = model.geom("mouth").id, model.geom("target").id, model.body("trunk").id
    radii = model.geom_size[[mouth, target], 0].sum()
    away = 0.016 * np.arange(12)[:, None] * np.array([0.6, 0.0, 0.8])
    states = jax.tree.map(lambda leaf: leaf[:12], shoal).replace(info={"goal": jnp.asarray(fish.goal_states[:12])})
    states = jax.jit(jax.vmap(fish.step))(states, jnp.asarray(np.linspace(-1, 1, 60).reshape(12, 5), jnp.float32))
    np.testing.assert_array_equal(states.data.mocap_pos[:, 0], fish.goal_states[:12], "the target is drawn at the goal")
    obs = np.hstack([states.obs[:, :33], states.obs[:, 21:24] + away])
    values = [np.asarray(f(jnp.asarray(obs, jnp.float32))) for f in (fish.reward, fish.success, fish.target_seen)]
    for lane, (row, reward, success, seen) in enumerate(zip(obs, *values, strict=True)):
        data = mujoco.MjData(model)
        data.qpos[:], data.mocap_pos[:] = states.data.qpos[lane], row[33:]
        mujoco.mj_forward(model, data)
        gap, upright = data.geom_xpos[target] - data.geom_xpos[mouth], data.xmat[trunk][8]
        np.testing.assert_allclose(row[21:24], data.geom_xpos[mouth], atol=1e-6)
        np.testing.assert_allclose(row[24:33], data.geom_xmat[mouth], atol=1e-6)
        np.testing.assert_allclose(seen, gap @ data.geom_xmat[mouth].reshape(3, 3), atol=1e-6)
        assert row[7] == pytest.approx(upright, abs=1e-6)
        left = max(np.linalg.norm(gap) - radii, 0.0) / (2 * radii)
        assert reward == pytest.approx((7 * 0.1 ** (left**2) + (upright + 1) / 2) / 8, abs=1e-5)
        assert success == (lane < 3)
    sparse = dataclasses.replace(fish, reward_type="sparse").reward(jnp.asarray(obs, jnp.float32))
    np.testing.assert_array_equal(sparse, np.arange(12) < 3)


def test_fish_starts_face_anywhere_slightly_bent(shoal):
    qpos = np.asarray(shoal.data.qpos)
    np.testing.assert_array_equal(qpos[:, :3], np.tile(np.float32([0, 0, 0.1]), (500, 1)))
    np.testing.assert_allclose(np.linalg.norm(qpos[:, 3:7], axis=1), 1.0, rtol=1e-6)
    np.testing.assert_allclose(qpos[:, 3:7].mean(axis=0), 0.0, atol=0.1)
    np.testing.assert_allclose((qpos[:, 3:7] ** 2).mean(axis=0), 0.25, atol=0.04)
    assert np.abs(qpos[:, 7:]).max() <= 0.2
    assert np.ptp(qpos[:, 7:], axis=0).min() > 0.38
    assert not np.asarray(shoal.data.qvel).any()
    np.testing.assert_array_equal(shoal.data.mocap_pos[:, 0], shoal.info["goal"])


def test_fish_goals_cover_the_suites_box_and_backward_goals_the_mouths_starts(fish, shoal):
    goals = fish.goal_states
    np.testing.assert_allclose([goals.min(axis=0), goals.max(axis=0)], [[-0.4, -0.4, 0.1], [0.4, 0.4, 0.3]], rtol=1e-6)
    assert len({tuple(row) for row in goals.tolist()}) == len(goals) == 405
    anywhere = np.random.default_rng(0).uniform([-0.4, -0.4, 0.1], [0.4, 0.4, 0.3], (2000, 3))
    assert np.linalg.norm(anywhere[:, None] - goals, axis=-1).min(axis=1).max() < 0.0751
    mouths = np.asarray(shoal.obs[:, 21:24])
    np.testing.assert_allclose(np.linalg.norm(fish.initial_states - [0, 0, 0.1], axis=1), 0.0745, rtol=1e-5)
    nearest = np.linalg.norm(mouths[:, None] - fish.initial_states, axis=-1).min(axis=1)
    assert nearest.max() < 0.045, "every start is a success of some backward goal"


@EVERY
def test_faults_are_what_physics_cannot_do(name):
    env = make(name, physics="c")
    state = jax.jit(env.reset)(jax.random.key(0))
    data, fault = state.data, jax.jit(env.fault)
    assert not bool(fault(state))
    broken = [state.replace(data=data.replace(qvel=data.qvel.at[3].set(jnp.nan)))]
    if name == "cheetah_run":
        broken += [state.replace(data=data.replace(qpos=data.qpos.at[1].set(height))) for height in (-1.5, 11.0)]
    else:
        broken += [state.replace(obs=state.obs.at[2].set(7.0))]
    assert all(map(fault, broken))


@EVERY
def test_saturated_steps_stay_finite_and_sound(name):
    env = make(name, physics="c")

    def step(carry, key):
        states, held = carry
        fresh, turn = jax.random.split(key)
        corner = jnp.sign(jax.random.uniform(fresh, held.shape, minval=-1, maxval=1))
        held = jnp.where(jax.random.uniform(turn, (len(held), 1)) < 0.1, corner, held)
        states = jax.vmap(env.step)(states, held)
        return (states, held), jax.vmap(env.fault)(states)

    keys, start = jax.random.split(jax.random.key(1), 500), (state_from_demo(env, 8), jnp.ones((8, env.action_size)))
    (states, _), faults = jax.jit(lambda carry: jax.lax.scan(step, carry, keys))(start)
    assert not np.asarray(faults).any()
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(states))


def theirs(suite, name, seed):
    env = suite.load(*name.split("_"), task_kwargs={"random": seed})
    env.reset()
    return env


def equal(found, wanted, fields, ours=slice(None), them=slice(None)):
    for field in fields:
        one, other = getattr(found, field)[ours], getattr(wanted, field)[them]
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-15, err_msg=field)


@EVERY
def test_the_compiled_model_is_the_suites(suite, name):
    one, other = theirs(suite, name, 0).physics.model.ptr, physics.load_model(name)
    equal(other, one, FIELDS.split())
    equal(other, one, BODY_FIELDS.split(), slice(other.nbody - one.nbody + 1, None), slice(1, None))
    for option in OPTIONS.split():
        np.testing.assert_array_equal(getattr(other.opt, option), getattr(one.opt, option), err_msg=option)
    if name == "cheetah_run":
        np.testing.assert_array_equal(other.jnt_range, one.jnt_range)
    else:
        assert not one.jnt_limited.any(), "ranges of joints without stops mean nothing, so ours has none"


def test_the_same_shapes_of_the_cheetah_touch_with_the_same_friction(suite):
    """Against all pairs that MuJoCo's own filter leaves to the suite's shapes, each with the larger friction."""
    one, other = theirs(suite, "cheetah_run", 0).physics.model.ptr, physics.load_model("cheetah_run")
    solid = sorted(set(other.pair_geom1) | set(other.pair_geom2))
    equal(other, one, ["geom_type", "geom_size", "geom_pos", "geom_quat"], solid[1:], slice(1, None))
    body, parent, friction = one.geom_bodyid, one.body_parentid, one.geom_friction
    assert set(one.geom_contype) | set(one.geom_conaffinity) == {1}
    wanted = {}
    for a, b in itertools.combinations(range(one.ngeom), 2):
        related = body[a] == body[b] or (body[a] and (parent[body[a]] == body[b] or parent[body[b]] == body[a]))
        if not related:
            wanted[a, b] = np.maximum(friction[a], friction[b]).tolist()
    ends = zip(other.pair_geom1, other.pair_geom2, other.pair_friction, strict=True)
    assert {(solid.index(a), solid.index(b)): slip[[0, 2, 3]].tolist() for a, b, slip in ends} == wanted
    for field in ("solref", "solimp", "margin", "gap"):
        pair, geom = getattr(other, f"pair_{field}"), getattr(one, f"geom_{field}")
        np.testing.assert_array_equal(np.unique(pair, axis=0), np.unique(geom, axis=0))


@EVERY
@pytest.mark.parametrize("seed", range(3))
def test_a_hundred_steps_beside_dm_control(suite, name, seed):
    """The same start and actions: joints, observation and reward of two lives, and of ours put back on theirs at each step.

    Put back, the last rounding to float32 is all there is: 1e-6 of the fastest joint. Living on, a rounding is carried through
    contacts and has been seen to grow to 4e-6 within the second or four; 1e-5 leaves room for other compilers.
    """
    env, other = make(name, physics="c"), theirs(suite, name, seed)
    world, start = other.physics.data, env.reset(jax.random.key(seed))
    if name == "fish_swim":
        start = env.with_goal(start, jnp.asarray(other.physics.named.model.geom_pos["target"], jnp.float32))

    def observed(obs):
        return obs if name == "cheetah_run" else np.concatenate([obs[:8], env.target_seen(obs), obs[8:21]])

    def put_back(state):
        names = ("qpos", "qvel", "qacc_warmstart")
        return state.replace(data=state.data.replace(**{n: jnp.asarray(getattr(world, n), jnp.float32) for n in names}))

    state, step = put_back(start), jax.jit(env.step)
    for action in np.random.default_rng(seed).uniform(-1, 1, (STEPS, env.action_size)).astype(np.float32):
        once, state, moment = step(put_back(start), action), step(state, action), other.step(action)
        seen = np.concatenate([np.atleast_1d(part) for part in moment.observation.values()])
        for reached, tolerated in ((once, 1e-6 * max(np.abs(world.qvel).max(), 1.0)), (state, 1e-5)):
            np.testing.assert_allclose(reached.data.qpos, world.qpos, atol=tolerated)
            np.testing.assert_allclose(reached.data.qvel, world.qvel, atol=tolerated)
            np.testing.assert_allclose(observed(reached.obs), seen, atol=tolerated)
            assert float(reached.reward) == pytest.approx(moment.reward, abs=1e-6)


def test_starts_are_distributed_as_the_suites(suite):
    """Means and spreads of settled positions over 150 of the suite's own resets."""
    other, split_setting = theirs(suite, "cheetah_run", 0), []
    for _ in range(150):
        other.reset()
        split_setting.append(other.physics.data.qpos[1:].copy())
    found, wanted = assets.starts("cheetah_run")["qpos"][:, 1:], np.asarray(split_setting)
    error = wanted.std(axis=0) * np.sqrt(1 / len(wanted) + 1 / len(found))
    assert (np.abs(found.mean(axis=0) - wanted.mean(axis=0)) < 4.5 * error + 1e-4).all()
    np.testing.assert_allclose(found.std(axis=0), wanted.std(axis=0), rtol=0.3, atol=1e-4)
