import os
import subprocess
import sys
import types
import xml.etree.ElementTree as ET

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax import assets
from earl_jax.envs import HelpBudget, list_envs, make
from earl_jax.physics import load_model
from earl_jax.rendering import scenes
from earl_jax.rendering.scenes import Scene, cameras, dressed, headless_backend, merged

mujoco = pytest.importorskip("mujoco", reason="pictures are drawn by MuJoCo")
SMALL = (64, 96)
MODELS = sorted(path.stem for path in (assets.root() / "mjcf").glob("*.xml"))
PHYSICS = ("qpos0", "jnt_type", "jnt_range", "jnt_axis", "body_mass", "body_inertia", "body_pos", "body_parentid")


@pytest.fixture(scope="module")
def drawing():
    try:
        Scene(make("tabletop_organization"), (8, 8)).close()
    except ValueError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="module")
def start(env):
    return env.reset(jax.random.key(0))


def posed(model, state):
    data = mujoco.MjData(model)
    data.qpos[:], data.mocap_pos[:], data.mocap_quat[:] = state.qpos, state.mocap_pos, state.mocap_quat
    mujoco.mj_kinematics(model, data)
    return data


@pytest.mark.parametrize("name", MODELS)
def test_a_look_changes_no_physics(name):
    plain, seen = load_model(name), dressed(name)
    assert seen.ngeom > plain.ngeom
    assert (seen.nq, seen.nv, seen.nu, seen.nbody, seen.nmocap) == (
        plain.nq,
        plain.nv,
        plain.nu,
        plain.nbody,
        plain.nmocap,
    )
    assert [seen.body(i).name for i in range(seen.nbody)] == [plain.body(i).name for i in range(plain.nbody)]
    for field in PHYSICS:
        np.testing.assert_array_equal(getattr(seen, field), getattr(plain, field), field)
    pose = types.SimpleNamespace(
        qpos=plain.qpos0 + 0.1, mocap_pos=np.ones((plain.nmocap, 3)), mocap_quat=np.ones((plain.nmocap, 4))
    )
    np.testing.assert_array_equal(posed(seen, pose).xpos, posed(plain, pose).xpos)


@pytest.mark.parametrize("name", list_envs())
def test_a_task_has_a_default_camera_and_a_second_one(name):
    assert "default" in cameras(make(name))
    assert len(cameras(make(name))) > 1


def tree(text):
    return ET.fromstring(f"<mujoco>{text}</mujoco>")


MODEL = tree(
    '<asset><material name="paint" rgba="1 0 0 1"/></asset><worldbody><light/><camera name="eye"/><geom size="1"/></worldbody>'
    '<worldbody><geom size="2"/><body name="hand"><geom size="3"/></body></worldbody>'
)


def test_a_bare_body_hides_what_the_model_draws_there():
    both = merged(
        MODEL, tree('<worldbody bare="true"><geom size="4"/></worldbody><body name="hand"><geom size="5"/></body>')
    )
    groups = {geom.get("size"): geom.get("group") for geom in both.iter("geom")}
    assert groups == {"1": "3", "2": "3", "3": None, "4": None, "5": None}
    assert [geom.get("size") for geom in both.find(".//body").findall("geom")] == ["3", "5"]
    assert MODEL.find("worldbody/geom").get("group") is None


def test_lights_assets_and_cameras_of_a_look_take_the_place_of_the_models():
    look = tree(
        '<asset><material name="paint" rgba="0 1 0 1"/></asset><worldbody><camera name="eye" pos="0 0 1"/></worldbody>'
    )
    both = merged(MODEL, look)
    assert [material.get("rgba") for material in both.iter("material")] == ["0 1 0 1"]
    assert [camera.get("pos") for camera in both.iter("camera")] == ["0 0 1"]
    assert not list(both.iter("light"))


def test_a_camera_looks_at_a_place_and_a_mesh_is_scaled():
    both = merged(
        MODEL,
        tree(
            '<asset><mesh name="ball" builtin="sphere"/></asset><worldbody><camera name="new" pos="0 -2 0" at="0 0 0"/>'
            '<geom mesh="ball" size="1 2 3"/><geom mesh="ball" size="1 2 3"/></worldbody>'
        ),
    )
    axes = np.array(both.find(".//camera[@name='new']").get("xyaxes").split(), float).reshape(2, 3)
    np.testing.assert_allclose(axes / np.linalg.norm(axes, axis=1)[:, None], [[1, 0, 0], [0, 0, 1]], atol=1e-12)
    assert [mesh.get("scale") for mesh in both.iter("mesh")] == [None, "1 2 3"]
    assert {geom.get("mesh") for geom in both.iter("geom") if geom.get("mesh")} == {"ball 1 2 3"}


def test_a_look_of_an_unknown_body_is_refused():
    with pytest.raises(ValueError, match="the body 'foot', which"):
        merged(MODEL, tree('<body name="foot"/>'))


def test_images_show_the_state_and_the_goal(drawing, env, start):
    moved = start.replace(data=start.data.replace(qpos=start.data.qpos + 1.0))
    other = env.with_goal(start, jnp.asarray(env.goal_states[0]))
    with Scene(env, SMALL) as scene:
        image = scene.image(start)
        assert (image.shape, image.dtype) == ((*SMALL, 3), np.uint8)
        np.testing.assert_array_equal(scene.image(start), image)
        assert (scene.image(moved) != image).any(axis=-1).sum() > 20
        assert (scene.image(other) != image).any(axis=-1).sum() > 10
    with Scene(env, SMALL, goal=False) as scene:
        bare = scene.image(start)
        np.testing.assert_array_equal(scene.image(other), bare)
    assert (bare != image).any()
    with Scene(env, SMALL, camera="above") as scene:
        assert (scene.image(start) != image).any()


def test_a_helped_world_is_drawn_like_its_task(drawing, env, start):
    helped = HelpBudget(env, budget=3.0)
    state = helped.reset(jax.random.key(0))
    with Scene(env, SMALL) as plain, Scene(helped, SMALL) as scene:
        np.testing.assert_array_equal(scene.image(state), plain.image(state.data))


def test_unknown_cameras_and_sizes_are_refused(env):
    with pytest.raises(ValueError, match="no camera 'mine'; choose from default, above"):
        Scene(env, SMALL, camera="mine")
    with pytest.raises(ValueError, match="size must be at least"):
        Scene(env, (0, 8))


def test_the_first_backend_that_draws_is_taken(monkeypatch):
    def works(*backends):
        headless_backend.cache_clear()

        def run(command, env, **_):
            return types.SimpleNamespace(returncode=int(env["MUJOCO_GL"] not in backends))

        monkeypatch.setattr(scenes.subprocess, "run", run)

    works("egl", "osmesa")
    assert headless_backend() == "egl"
    works("osmesa")
    assert headless_backend() == "osmesa"
    works()
    with pytest.raises(ValueError, match="apt-get install libegl1"):
        headless_backend()
    headless_backend.cache_clear()


GOALS = {"sawyer_door": "handle", "sawyer_peg": "head", "dhand_lightbulb": "bulb"}


@pytest.mark.parametrize("name", GOALS)
def test_the_goal_that_is_shown_is_the_goal(name):
    env = make(name)
    state = env.reset(jax.random.key(3))
    data = posed(load_model(env.model), jax.device_get(env.render_goal(state)))
    np.testing.assert_allclose(data.site(GOALS[name]).xpos, state.info["goal"][-3:], atol=2e-4)


@pytest.mark.slow
def test_goals_of_the_other_tasks_are_shown():
    for name, places in (
        ("franka_kitchen", slice(9, 18)),
        ("minitaur_pen", slice(2)),
        ("tabletop_organization", slice(4)),
    ):
        env = make(name)
        state = env.reset(jax.random.key(3))
        wanted = (
            env.goal_states[0][[9, 11, 13, 15, 17, 19, 20, 21, 22]] if name == "franka_kitchen" else state.info["goal"]
        )
        np.testing.assert_array_equal(env.render_goal(state).qpos[places], wanted[: places.stop])
    fish = make("fish_swim")
    goal = jnp.asarray(fish.goal_states[7])
    np.testing.assert_array_equal(
        fish.render_goal(fish.with_goal(fish.reset(jax.random.key(0)), goal)).mocap_pos[0], goal
    )
    assert make("cheetah_run").render_goal(make("cheetah_run").reset(jax.random.key(0))) is None


@pytest.mark.parametrize("name", ["tabletop_organization", "sawyer_door", "sawyer_peg"])
def test_demonstrations_can_be_begun(name):
    env = make(name)
    demos = env.demos("forward")
    state = env.state_from_demo(jnp.asarray(demos.states[0]), jnp.asarray(demos.goals[0]))
    np.testing.assert_allclose(state.obs, np.concatenate([demos.states[0], demos.goals[0]]), atol=2e-3)


OBJECTS = {
    "sawyer_door": 9, "sawyer_peg": 9, "franka_kitchen": 17, "dhand_lightbulb": 23, "minitaur_pen": 0, "cheetah_run": 3,
    "fish_swim": 0, "tabletop_organization": 2,
}  # fmt: skip
"""A joint of the thing that each task is about."""


@pytest.mark.slow
@pytest.mark.parametrize("name", list_envs())
def test_what_a_task_is_about_is_seen_to_move(drawing, name):
    env = make(name)
    state = env.reset(jax.random.key(0))
    qpos = state.data.qpos
    moved = state.replace(data=state.data.replace(qpos=qpos.at[OBJECTS[name]].add(0.25)))
    with Scene(env, SMALL, goal=False) as scene:
        before, after = scene.image(state), scene.image(moved)
    assert before.std() > 10
    assert 10 < (before != after).any(axis=-1).sum() < (1.0 if name == "cheetah_run" else 0.7) * before[..., 0].size


PROGRAM = """
import mujoco, jax
from earl_jax.envs import make
from earl_jax.scenes import Scene
env = make("tabletop_organization")
with Scene(env, (64, 96)) as scene:
    print(scene.image(env.reset(jax.random.key(0))).std())
"""


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["", "egl", "osmesa"])
def test_no_display_is_needed(drawing, backend):
    """MuJoCo chooses its backend when it is imported, which is before the scene is made."""
    screens = ("DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL", "PYOPENGL_PLATFORM")
    environment = {name: value for name, value in os.environ.items() if name not in screens}
    environment |= {"MUJOCO_GL": backend} if backend else {}
    done = subprocess.run([sys.executable, "-c", PROGRAM], env=environment, capture_output=True, text=True)
    if backend and done.returncode:
        pytest.skip(f"{backend} is not installed")
    assert float(done.stdout) > 10, done.stderr
