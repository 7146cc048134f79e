"""Finds a way to draw without a display: EGL, else OSMesa."""

import functools
import importlib
import os
import platform
import subprocess
import sys
from typing import Any

from earl_jax.errors import InputError

BACKENDS = ("egl", "osmesa")
"""Values of `MUJOCO_GL` that need no display: a GPU's driver or Mesa through EGL, and Mesa's software renderer."""
PROBE = "import mujoco; mujoco.GLContext(8, 8).make_current()"
NO_GRAPHICS = (
    "no way to draw without a display: install EGL (apt-get install libegl1 libgl1-mesa-dri) "
    "or OSMesa (apt-get install libosmesa6), or set MUJOCO_GL"
)


def drawing_mujoco() -> Any:
    """Return the module `mujoco`, able to draw: on Linux without a display, through the first of `BACKENDS` that works.

    Raises:
        ValueError: no backend works; the message says what to install.
    """
    has_display = any(os.environ.get(name) for name in ("MUJOCO_GL", "DISPLAY", "WAYLAND_DISPLAY"))
    if platform.system() == "Linux" and not has_display:
        os.environ["MUJOCO_GL"] = headless_backend()
        if "mujoco" in sys.modules:  # mujoco chose its backend when it was imported
            renderer: Any = sys.modules[sys.modules["mujoco"].Renderer.__module__]
            importlib.reload(renderer.gl_context)
    return importlib.import_module("mujoco")


@functools.cache
def headless_backend() -> str:
    """Return the first of `BACKENDS` that draws here.

    Each is tried in a process of its own, because a process cannot recover from a failed one.

    Raises:
        ValueError: no backend works; the message says what to install.
    """
    for backend in BACKENDS:
        environment = {**os.environ, "MUJOCO_GL": backend}
        if not subprocess.run([sys.executable, "-c", PROBE], env=environment, capture_output=True).returncode:
            return backend
    raise InputError(NO_GRAPHICS)
