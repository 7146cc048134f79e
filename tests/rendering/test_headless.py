"""Drawing without a display: the choice of the graphics backend."""

import os
import subprocess
import sys
import types

import pytest

from earl_jax.rendering import headless
from earl_jax.rendering.headless import headless_backend


def test_the_first_working_backend_is_chosen(monkeypatch):
    def install(*backends):
        headless_backend.cache_clear()

        def run(command, env, **_):
            return types.SimpleNamespace(returncode=int(env["MUJOCO_GL"] not in backends))

        monkeypatch.setattr(headless.subprocess, "run", run)

    install("egl", "osmesa")
    assert headless_backend() == "egl"
    install("osmesa")
    assert headless_backend() == "osmesa"
    install()
    with pytest.raises(ValueError, match="apt-get install libegl1"):
        headless_backend()
    headless_backend.cache_clear()


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
