"""Images of states and goals, and the choice of a graphics backend that needs no display."""

import types
from unittest.mock import Mock

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.envs import HelpBudget, make
from earl_jax.physics import mujoco_data
from earl_jax.rendering import scenes
from earl_jax.rendering.scenes import Scene
from tests.envs.chain import Chain
from tests.envs.programs import first_state, program

SMALL = (64, 96)


def test_images_show_the_state_and_the_goal(graphics, env):
    start = first_state(env)
    moved = start.replace(data=start.data.replace(qpos=start.data.qpos + 1.0))
    other_goal = env.with_goal(start, jnp.asarray(env.goal_states[0]))
    helped_env = HelpBudget(env, budget=3.0)
    helped = first_state(helped_env)
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
        with pytest.raises(ValueError, match=r"a State, which in a life is state\.env_state, not \["):
            scene.image(start.obs)
        with pytest.raises(ValueError, match=r"one state of its own task: qpos has shape \(2, .*\), not \("):
            scene.image(jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), start))


def test_unknown_cameras_and_sizes_and_tasks_without_pictures_are_refused(graphics, env):
    with pytest.raises(ValueError, match="chain cannot be drawn: it has no view"):
        Scene(Chain(), SMALL)
    with pytest.raises(ValueError, match="unknown camera 'mine'; choose from default, above"):
        Scene(env, SMALL, camera="mine")
    with pytest.raises(ValueError, match="height must lie in"):
        Scene(env, (0, 8))
    with pytest.raises(ValueError, match=r"cannot draw pictures of 8 by 2000000 pixels .*framebuffer"):
        Scene(env, (8, 2_000_000))


@pytest.mark.parametrize(
    ("name", "site"), [("sawyer_door", "handle"), ("sawyer_peg", "head"), ("dhand_lightbulb", "bulb")]
)
def test_goal_markers_are_at_the_goal(name, site):
    env = make(name)
    state = program(env, "reset")(jax.random.key(3))
    data = mujoco_data(env.view.model, env.view.render_goal(state))
    np.testing.assert_allclose(data.site(site).xpos, state.info["goal"][-3:], atol=2e-4)


def test_a_backend_that_the_machine_lacks_is_named(monkeypatch, env):
    failure = AttributeError("'NoneType' object has no attribute 'glGetError'")
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    monkeypatch.setattr(scenes.importlib, "import_module", Mock(side_effect=failure))
    with pytest.raises(ValueError, match=r"no way to draw.* set MUJOCO_GL .osmesa: .*glGetError"):
        Scene(env, SMALL)


def test_the_first_working_backend_is_chosen(monkeypatch):
    def chosen(*backends):
        def run(command, env, **_):
            return types.SimpleNamespace(returncode=int(env["MUJOCO_GL"] not in backends))

        monkeypatch.setattr(scenes.subprocess, "run", run)
        return scenes.working_backend.__wrapped__()

    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setenv("DISPLAY", "localhost:10.0")
    assert chosen("egl", "osmesa") == "egl"
    assert chosen("osmesa") == "osmesa"
    assert chosen() == "glfw"
    monkeypatch.delenv("DISPLAY")
    with pytest.raises(ValueError, match="apt-get install libegl1"):
        chosen()
