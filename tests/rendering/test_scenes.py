"""Images of states and goals, and the choice of a graphics backend that needs no display."""

import os
import subprocess
import sys
import types

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.envs import HelpBudget, list_envs, make
from earl_jax.physics import load_model
from earl_jax.rendering import scenes
from earl_jax.rendering.scenes import Scene

mujoco = pytest.importorskip("mujoco", reason="pictures are drawn by MuJoCo")
SMALL = (64, 96)


def test_images_show_the_state_and_the_goal(graphics, env):
    start = env.reset(jax.random.key(0))
    moved = start.replace(data=start.data.replace(qpos=start.data.qpos + 1.0))
    other_goal = env.with_goal(start, jnp.asarray(env.goal_states[0]))
    helped_env = HelpBudget(env, budget=3.0)
    helped = helped_env.reset(jax.random.key(0))
    with Scene(env, SMALL) as scene, Scene(helped_env, SMALL) as helped_scene:
        image = scene.image(start)
        assert (image.shape, image.dtype) == ((*SMALL, 3), np.uint8)
        np.testing.assert_array_equal(scene.image(start), image)
        np.testing.assert_array_equal(helped_scene.image(helped), scene.image(helped.data))
        assert (scene.image(moved) != image).any(axis=-1).sum() > 20
        assert (scene.image(other_goal) != image).any(axis=-1).sum() > 10
    with Scene(env, SMALL, goal=False) as scene:
        without_goal = scene.image(start)
        np.testing.assert_array_equal(scene.image(other_goal), without_goal)
    assert (without_goal != image).any()
    with Scene(env, SMALL, camera="above") as scene:
        assert (scene.image(start) != image).any()


def test_unknown_cameras_and_sizes_are_refused(graphics, env):
    with pytest.raises(ValueError, match="no camera 'mine'; choose from default, above"):
        Scene(env, SMALL, camera="mine")
    with pytest.raises(ValueError, match="size must be at least"):
        Scene(env, (0, 8))


GOAL_SITES = {"sawyer_door": "handle", "sawyer_peg": "head", "dhand_lightbulb": "bulb"}


@pytest.mark.parametrize("name", GOAL_SITES)
def test_goal_markers_are_at_the_goal(name):
    env = make(name)
    state = env.reset(jax.random.key(3))
    goal = jax.device_get(env.render_goal(state))
    model = load_model(env.model)
    data = mujoco.MjData(model)
    data.qpos[:], data.mocap_pos[:], data.mocap_quat[:] = goal.qpos, goal.mocap_pos, goal.mocap_quat
    mujoco.mj_kinematics(model, data)
    np.testing.assert_allclose(data.site(GOAL_SITES[name]).xpos, state.info["goal"][-3:], atol=2e-4)


OBJECTS = {
    "sawyer_door": 9, "sawyer_peg": 9, "franka_kitchen": 17, "dhand_lightbulb": 23, "minitaur_pen": 0, "cheetah_run": 3,
    "fish_swim": 0, "tabletop_organization": 2,
}  # fmt: skip
"""Index in qpos of a joint of each task's object."""


@pytest.mark.slow
@pytest.mark.parametrize("name", list_envs())
def test_a_moved_object_changes_the_image(graphics, name):
    env = make(name)
    state = env.reset(jax.random.key(0))
    qpos = state.data.qpos
    moved = state.replace(data=state.data.replace(qpos=qpos.at[OBJECTS[name]].add(0.25)))
    with Scene(env, SMALL, goal=False) as scene:
        before, after = scene.image(state), scene.image(moved)
    assert before.std() > 10
    assert 10 < (before != after).any(axis=-1).sum() < (1.0 if name == "cheetah_run" else 0.7) * before[..., 0].size


def test_the_first_working_backend_is_chosen(monkeypatch):
    def install(*backends):
        scenes.headless_backend.cache_clear()

        def run(command, env, **_):
            return types.SimpleNamespace(returncode=int(env["MUJOCO_GL"] not in backends))

        monkeypatch.setattr(scenes.subprocess, "run", run)

    install("egl", "osmesa")
    assert scenes.headless_backend() == "egl"
    install("osmesa")
    assert scenes.headless_backend() == "osmesa"
    install()
    with pytest.raises(ValueError, match="apt-get install libegl1"):
        scenes.headless_backend()
    scenes.headless_backend.cache_clear()


PROGRAM = """
import mujoco, jax
from earl_jax.envs import make
from earl_jax.rendering import Scene
env = make("tabletop_organization")
with Scene(env, (64, 96)) as scene:
    print(scene.image(env.reset(jax.random.key(0))).std())
"""


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["", "egl", "osmesa"])
def test_no_display_is_needed(graphics, backend):
    """MuJoCo chooses its backend at import, which the program does before it makes the scene."""
    screens = ("DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL", "PYOPENGL_PLATFORM")
    environment = {name: value for name, value in os.environ.items() if name not in screens}
    environment |= {"MUJOCO_GL": backend} if backend else {}
    finished = subprocess.run([sys.executable, "-c", PROGRAM], env=environment, capture_output=True, text=True)
    if backend and finished.returncode:
        pytest.skip(f"{backend} is not installed")
    assert float(finished.stdout) > 10, finished.stderr
