"""MuJoCo behind one door: three engines that agree, and the kinematic task seen through MuJoCo."""

import dataclasses
import importlib.util

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks.replay_demos import begin
from earl_jax import assets, physics
from earl_jax.envs import make, with_physics

SAWYERS = ("sawyer_door", "sawyer_peg")
EVERY = pytest.mark.parametrize("name", SAWYERS)
FREE = 5
"""Control steps of a demonstration in which nothing touches the hand."""


def placed(env):
    state = env.reset(jax.random.key(0))
    for action in ([1.0, 0.5, 0.0], [1.0, -0.2, 0.0]):
        state = env.step(state, jnp.array(action))
    return state


def test_mujoco_draws_gripper_and_mug_where_the_observation_has_them(env):
    state = placed(env)
    model, data = physics.load_model(env.name), physics.mujoco_data(env.name, state.data)
    for body, part in (("gripper", slice(0, 2)), ("mug", slice(2, 4))):
        np.testing.assert_allclose(data.xpos[model.body(body).id][:2], state.obs[part], atol=1e-6)
    assert model.nu == 0
    assert data.ncon == 0


def test_mjx_agrees_with_mujoco(env):
    state = placed(env)
    ours, theirs = physics.mjx_data(env.name, state.data), physics.mujoco_data(env.name, state.data)
    np.testing.assert_allclose(ours.xpos, theirs.xpos, atol=1e-6)
    np.testing.assert_allclose(ours.qpos, theirs.qpos, atol=1e-7)


def test_coasters_are_drawn_at_the_goals(env):
    model = physics.load_model(env.name)
    for colour, goal in zip("rgbk", env.goal_states, strict=True):
        np.testing.assert_allclose(model.geom(f"coaster_{colour}").pos[:2], goal[2:4])
    np.testing.assert_allclose(model.geom("start").pos[:2], env.initial_states[0, 2:4])


def test_the_integration_state_is_all_a_lane_carries(env):
    data = env.reset(jax.random.key(0)).data
    assert sum(leaf.size for leaf in jax.tree.leaves(data)) == 4 + 4 + 4 + 1


def test_an_unknown_model_names_the_choices():
    with pytest.raises(ValueError, match="tabletop_organization"):
        physics.load_model("table")


FAST_TO_COMPILE = {"xla_backend_optimization_level": 0}
"""For MJX, whose programs compile for half a minute; the door's is compiled as the suite's others are."""


def compiled(name, engine, function):
    fast = engine == "mjx" and name != "sawyer_door"
    return jax.jit(jax.vmap(function), compiler_options=FAST_TO_COMPILE if fast else {})


def scripted(name, engine, episodes=2, steps=60):
    """What is observed [episodes, steps, 7] when the first shipped demonstrations are played on `engine`."""
    env, part = make(name, physics=engine), assets.demos(name, "forward")
    firsts = np.append(0, np.flatnonzero(part.ends) + 1)[:episodes]
    actions = jnp.asarray(np.stack([part.actions[first : first + steps] for first in firsts]))

    def play(state, actions):
        return jax.lax.scan(lambda s, a: (lambda n: (n, n.obs[:7]))(env.step(s, a)), state, actions)[1]

    starts = [begin(env, np.hstack([part.states[first], part.goals[first]])) for first in firsts]
    states = jax.tree.map(lambda *leaves: jnp.stack(leaves), *starts)
    return np.asarray(compiled(name, engine, play)(states, actions))


def agree(one, other, touching_mm):
    free = np.abs(one[:, :FREE, :3] - other[:, :FREE, :3])
    assert free.max() < 5e-4, "metres: the weld of MuJoCo's C engine has had a term since 3.7 that MJX lacks"
    assert np.median(free) < 5e-5
    assert 1e3 * np.linalg.norm(one[..., 4:] - other[..., 4:], axis=-1).mean() < touching_mm


@EVERY
def test_mjx_and_c_agree_before_contact_tightly_and_in_contact_on_average(name):
    agree(scripted(name, "mjx"), scripted(name, "c"), touching_mm=2.0)


NEW = {"cheetah_run": 5e-4, "dhand_lightbulb": 0.03, "fish_swim": 1e-4, "franka_kitchen": 5e-3, "minitaur_pen": 0.03}
"""Tasks without demonstrations, and how far [m, rad] joints may be apart after `WAVES` control steps, contacts included."""
EARLY, EARLY_APART = 5, 1e-3
WAVES = 15


def waved(name, engine, lanes=2):
    """Joint positions [lanes, WAVES, nq] under slow sines, a phase and a speed an action."""
    env = make(name, physics=engine)
    time, number = np.arange(WAVES)[:, None], np.arange(env.action_size)
    actions = jnp.asarray(0.8 * np.sin(0.2 * time * (1 + 0.2 * number) + number), jnp.float32)
    states = lanes_of(env, lanes)

    def life(state):
        return jax.lax.scan(lambda s, a: (lambda n: (n, n.data.qpos))(env.step(s, a)), state, actions)[1]

    return np.asarray(compiled(name, engine, life)(states))


@pytest.mark.parametrize("name", NEW)
def test_mjx_and_c_move_the_other_tasks_alike(name):
    one, other = waved(name, "mjx"), waved(name, "c")
    assert np.ptp(other, axis=1).max() > 0.05, "something moves"
    np.testing.assert_allclose(one, other, atol=NEW[name])
    np.testing.assert_allclose(one[:, :EARLY], other[:, :EARLY], atol=EARLY_APART)


@pytest.mark.skipif(importlib.util.find_spec("warp") is None, reason="the extra earl-jax[warp] is not installed")
@pytest.mark.parametrize("name", NEW)
def test_warp_and_c_move_the_other_tasks_alike(name):
    one, other = waved(name, "warp"), waved(name, "c")
    np.testing.assert_allclose(one, other, atol=NEW[name])
    np.testing.assert_allclose(one[:, :EARLY], other[:, :EARLY], atol=EARLY_APART)


@pytest.mark.skipif(importlib.util.find_spec("warp") is None, reason="the extra earl-jax[warp] is not installed")
@EVERY
def test_warp_and_c_agree(name):
    agree(scripted(name, "warp", steps=20), scripted(name, "c", steps=20), touching_mm=2.0)


@pytest.mark.gpu
@pytest.mark.skipif(jax.default_backend() == "cpu", reason="needs an accelerator")
@EVERY
def test_mjx_on_an_accelerator_computes_in_full_float32(name):
    agree(scripted(name, "mjx"), scripted(name, "c"), touching_mm=2.0)


def lanes_of(env, count):
    return jax.vmap(env.reset)(jax.random.split(jax.random.key(0), count))


@EVERY
def test_c_makes_one_call_for_all_lanes_however_they_are_nested(name, monkeypatch):
    env = make(name, physics="c")
    host, shapes = physics.c.host_of(env.simulator, 0), []

    def counted(rows, stream):
        shapes.append(len(rows))
        return host(rows, stream)

    monkeypatch.setattr(physics.c, "host_of", lambda simulator, memory: counted)
    states = jax.tree.map(lambda leaf: leaf.reshape(2, 3, *leaf.shape[1:]), lanes_of(env, 6))
    action = jnp.array([0.3, -0.2, 0.1, -1.0])
    nested = jax.jit(jax.vmap(jax.vmap(lambda s: env.step(s, action))))(states)
    nested.obs.block_until_ready()
    assert shapes == [6]
    alone = env.step(jax.tree.map(lambda leaf: leaf[1, 2], states), action)
    np.testing.assert_allclose(nested.obs[1, 2], alone.obs, rtol=1e-6, atol=1e-6)


def test_the_sensors_lag_the_state_by_one_substep():
    env = make("sawyer_door", physics="c", substeps=1)
    state = env.reset(jax.random.key(0))
    after = env.step(state, jnp.array([1.0, 1.0, -1.0, 1.0]))
    np.testing.assert_allclose(after.obs[:3], state.obs[:3], atol=1e-6)
    assert np.abs(np.asarray(after.data.qpos[:9] - state.data.qpos[:9])).max() > 1e-4


def test_a_broken_lane_stays_broken_and_alone_on_c():
    env = make("sawyer_peg", physics="c")
    states = lanes_of(env, 3)
    broken = states.replace(data=states.data.replace(qvel=states.data.qvel.at[1].set(jnp.nan)))
    step = jax.jit(jax.vmap(lambda s: env.step(s, jnp.ones(4))))
    after, whole = step(broken), step(states)
    assert np.asarray(jax.vmap(env.fault)(after)).tolist() == [False, True, False]
    for lane in (0, 2):
        np.testing.assert_array_equal(after.obs[lane], whole.obs[lane])


@EVERY
def test_leaving_the_workspace_is_a_fault(name):
    env = make(name, physics="c")
    state = env.reset(jax.random.key(0))
    assert not bool(env.fault(state))
    assert bool(env.fault(state.replace(obs=state.obs.at[5].set(2.0))))
    assert bool(env.fault(state.replace(obs=state.obs.at[2].set(-0.5))))


def test_engines_are_chosen_by_name_and_missing_ones_name_their_extra(monkeypatch, env):
    assert make("sawyer_door").engine == physics.FASTEST["cpu"] == "c"
    assert env.engine == "kinematic"
    assert with_physics(make("sawyer_door"), "mjx").engine == "mjx"
    with pytest.raises(ValueError, match="choose from auto, mjx, warp, c"):
        make("sawyer_door", physics="bullet")
    with pytest.raises(ValueError, match="plain arithmetic"):
        with_physics(env, "c")
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(ValueError, match=r"'warp' is not installed.*earl-jax\[warp\]"):
        make("sawyer_door", physics="warp")


def test_auto_turns_to_the_accelerator_where_lanes_are_too_many_for_the_cores(monkeypatch):
    assert physics.fastest("minitaur_pen", 10_000) == "c"
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    monkeypatch.setattr(physics.c, "cores", lambda: 16)
    taken = [physics.fastest("minitaur_pen", lanes) for lanes in (50, 400, 600)]
    assert taken == ["c", "c", "mjx"]
    assert physics.fastest("sawyer_door", 500) == "c"
    monkeypatch.setattr(physics.c, "cores", lambda: 4)
    assert physics.fastest("minitaur_pen", 200) == "mjx"
    assert make("minitaur_pen").for_lanes(200).engine == "mjx"
    assert make("minitaur_pen", physics="c").for_lanes(200).engine == "c"


def test_few_rows_wake_few_threads(monkeypatch):
    monkeypatch.setattr(physics.c, "cores", lambda: 16)
    worker_pool = physics.c.WorkerPool(physics.c.host_of(make("sawyer_door", physics="c").simulator, 0), 16)
    assert [worker_pool._threads(rows) for rows in (1, 16, 50, 64, 65)] == [8, 8, 12, 12, 16]


@EVERY
def test_the_arm_is_as_heavy_as_the_original(name):
    """Inverse weights of the seven joints, as the original compiles: a shape that should only be seen would change them."""
    original = [0.287820, 3.924983, 40.165526, 15.700716, 125.917170, 139.201912, 691.249256]
    np.testing.assert_allclose(physics.load_model(name).dof_invweight0[:7], original, rtol=1e-4)


def test_the_compiled_model_has_the_weld_of_the_original():
    model = physics.load_model("sawyer_door")
    hand = model.body_invweight0[model.body("hand").id]
    np.testing.assert_allclose(hand, 6.1056272, rtol=1e-6)
    assert dataclasses.replace(make("sawyer_door"), substeps=4).simulator.mujoco_model().opt.timestep == 0.0125 / 4
    assert model.opt.timestep == 0.0025
