"""Images of states: MuJoCo renders the task's model with its overlay, without a display."""

import contextlib
import functools
import importlib
import os
import platform
import subprocess
import sys
from typing import Any

import numpy as np

from earl_jax.envs import Env, State, View
from earl_jax.errors import InputError, brief, require_known
from earl_jax.options.environment import PYTHON
from earl_jax.options.values import COUNT, require
from earl_jax.rendering.overlays import with_overlay

STATE_GROUPS = (0, 1, 2)
"""Groups of geoms that are drawn in the pose of the state."""
GOAL_GROUPS = (5,)
"""Groups of geoms that are drawn in the pose of the goal: the overlay's class `goal_marker`."""
BACKENDS = ("egl", "osmesa")
"""Values of `MUJOCO_GL` that need no display: a GPU's driver or Mesa through EGL, and Mesa's software renderer."""
PROBE = "import mujoco; mujoco.GLContext(8, 8).make_current()"
NO_GRAPHICS = (
    "no way to draw without a display: install EGL (apt-get install libegl1 libgl1-mesa-dri) "
    "or OSMesa (apt-get install libosmesa6), or set MUJOCO_GL"
)

NO_BACKEND = (ImportError, RuntimeError, AttributeError)
"""The errors of mujoco, and of OpenGL's library, for a backend that `MUJOCO_GL` names and this machine lacks."""


class Scene(contextlib.AbstractContextManager):
    """A camera on one task: `image(state)` draws a state. Close it, or use it in a `with` block."""

    def __init__(self, env: Env, size: tuple[int, int] = (480, 640), camera: str | None = None, goal: bool = True):
        """Make the scene of `env`.

        Args:
            env: a task with a MuJoCo model.
            size: height and width of the images.
            camera: a camera of the model; by default the one named `default`, or else MuJoCo's free camera.
            goal: whether to draw goal markers too.

        Raises:
            ValueError: the task has no model, the model has no such camera, or this machine cannot draw.
        """
        self._mujoco = mujoco = _drawing_mujoco()
        self.goal = goal
        self._view = view_of(env)
        self.model = _drawn_model(env)
        known = cameras(env)
        if camera is not None:
            require_known("camera", camera, known)
        self.camera = camera or ("default" if "default" in known else -1)
        self._data = mujoco.MjData(self.model)
        self._of_state, self._of_goal = (_options(mujoco, groups) for groups in (STATE_GROUPS, GOAL_GROUPS))
        self._renderer = _renderer(mujoco, self.model, size)

    def image(self, state: State) -> np.ndarray:
        """Return the picture of one unbatched `state`, uint8 [h, w, 3].

        Raises:
            ValueError: `state` is no `State`, or one of several lanes or of another task.
        """
        if not isinstance(state, State):
            raise InputError(f"an image shows a State, which in a life is state.env_state, not {brief(state)}")
        mujoco, data, scene = self._mujoco, self._data, self._renderer.scene
        self._place(data, self._view.render_state(state))
        self._renderer.update_scene(data, self.camera, self._of_state)
        first_marker = scene.ngeom
        goal = self._view.render_goal(state) if self.goal else None
        if goal is not None:
            self._place(data, goal)
            mujoco.mjv_addGeoms(self.model, data, self._of_goal, mujoco.MjvPerturb(), mujoco.mjtCatBit.mjCAT_ALL, scene)
        for number, geom in enumerate(scene.geoms[: scene.ngeom]):  # planes and markers cast no shadow
            if number >= first_marker or geom.type == mujoco.mjtGeom.mjGEOM_PLANE:
                geom.category = mujoco.mjtCatBit.mjCAT_DECOR
        return self._renderer.render()

    def _place(self, data: Any, state: Any) -> None:
        if (shape := np.shape(state.qpos)) != data.qpos.shape:
            raise InputError(f"an image shows one state of its own task: qpos has shape {shape}, not {data.qpos.shape}")
        data.qpos[:], data.mocap_pos[:], data.mocap_quat[:] = state.qpos, state.mocap_pos, state.mocap_quat
        self._mujoco.mj_fwdPosition(self.model, data)

    def close(self) -> None:
        """Release the resources of the graphics driver; the scene cannot draw afterwards."""
        self._renderer.close()

    def __exit__(self, *_: object) -> None:
        self.close()


def cameras(env: Env) -> list[str]:
    """Return the names of the cameras of `env`."""
    model = _drawn_model(env)
    return [model.camera(number).name for number in range(model.ncam)]


def view_of(env: Env) -> View:
    """Return how `env` is drawn.

    Raises:
        ValueError: the task has no pictures.
    """
    if env.view is None:
        raise InputError(f"{env.name} cannot be drawn: it has no view")
    return env.view


def _drawn_model(env: Env) -> Any:
    """Return the compiled model of `env` with its overlay. Errors as `Scene`."""
    view = view_of(env)
    try:
        return with_overlay(view.model)
    except ValueError as error:
        raise InputError(f"{env.name} cannot be drawn: {error}") from error


def _options(mujoco: Any, groups: tuple[int, ...]) -> Any:
    """Return MuJoCo's options that draw the geoms of `groups` and nothing else."""
    options = mujoco.MjvOption()
    options.geomgroup[:] = np.isin(np.arange(6), groups)
    options.sitegroup[:] = options.tendongroup[:] = 0
    return options


def checked_size(size: Any) -> tuple[int, int]:
    """Return the height and the width in `size`; an InputError if it is not a pair of whole numbers above 0."""
    try:
        height, width = size
    except (TypeError, ValueError):
        raise InputError(f"size must be a height and a width, such as (480, 640), not {brief(size)}") from None
    require("height", height, COUNT)
    require("width", width, COUNT)
    return height, width


def _renderer(mujoco: Any, model: Any, size: tuple[int, int]) -> Any:
    height, width = checked_size(size)
    model.vis.global_.offheight, model.vis.global_.offwidth = size
    try:
        return mujoco.Renderer(model, height, width)
    except (*NO_BACKEND, mujoco.FatalError) as error:
        if "framebuffer" in str(error):
            raise InputError(f"this machine cannot draw pictures of {height} by {width} pixels ({error})") from error
        raise _no_graphics(error) from error


def _drawing_mujoco() -> Any:
    """Return the module `mujoco`, ready to draw: on Linux through `MUJOCO_GL` or, if unset, `working_backend`.

    Raises:
        ValueError: no backend works, or the one in `MUJOCO_GL` does not; the message says what to install.
    """
    if platform.system() == "Linux" and not os.environ.get("MUJOCO_GL"):
        os.environ["MUJOCO_GL"] = working_backend()
        if "mujoco" in sys.modules:  # mujoco chose its backend when it was imported
            renderer: Any = sys.modules[sys.modules["mujoco"].Renderer.__module__]
            importlib.reload(renderer.gl_context)
    try:
        return importlib.import_module("mujoco")
    except NO_BACKEND as error:
        raise _no_graphics(error) from error


def _no_graphics(error: Exception) -> InputError:
    return InputError(f"{NO_GRAPHICS} ({os.environ.get('MUJOCO_GL', 'unset')}: {error})")


@functools.cache
def working_backend() -> str:
    """Return the first of `BACKENDS` that draws here, or else the backend of a display, which may no longer exist.

    Each backend is tried in a process of its own, because a process cannot recover from a failed backend.

    Raises:
        ValueError: no backend works; the message says what to install.
    """
    for backend in BACKENDS:
        environment = {**os.environ, "MUJOCO_GL": backend}
        if not subprocess.run([*PYTHON, "-c", PROBE], env=environment, capture_output=True).returncode:
            return backend
    if any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")):
        return "glfw"
    raise InputError(NO_GRAPHICS)
