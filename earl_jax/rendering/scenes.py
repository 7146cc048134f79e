"""From a state to an image: a task's model, dressed for pictures by `assets/looks`, drawn by MuJoCo without a display."""

import copy
import functools
import importlib
import os
import platform
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np

from earl_jax import assets
from earl_jax.envs import Env, State

BACKENDS = ("egl", "osmesa")
"""What draws without a display: a GPU's driver or Mesa through EGL, else Mesa's software alone."""
PROBE = "import mujoco; mujoco.GLContext(8, 8).make_current()"
NO_GRAPHICS = (
    "no way to draw without a display: install EGL (apt-get install libegl1 libgl1-mesa-dri) "
    "or OSMesa (apt-get install libosmesa6), or set MUJOCO_GL"
)
SEEN, UNSEEN, GOAL = (0, 1, 2), 3, 5
"""Groups of geoms: drawn where they are, never drawn, and drawn where the goal would have them."""
LOOK = "look"
"""The default class of a geom in a look that names none."""


class Scene:
    """A camera on one task: `image(state)` draws it. Close it, or use it in a `with` block."""

    def __init__(self, env: Env, size: tuple[int, int] = (480, 640), camera: str | None = None, goal: bool = True):
        """Make the scene of `env`.

        Args:
            env: a task with a MuJoCo model.
            size: height and width of the images.
            camera: a camera of the model; `default` where there is one, else MuJoCo's free camera.
            goal: also draw where the commanded goal is.

        Raises:
            ValueError: the task has no model, the model no such camera, or nothing here can draw.
        """
        mujoco = _mujoco()
        self.env, self.goal = env, goal
        try:
            self.model = dressed(env.model)
        except ValueError as error:
            raise ValueError(f"{env.name} has no picture: {error}") from error
        self.data, self.wanted = mujoco.MjData(self.model), mujoco.MjData(self.model)
        self.camera = _camera(self.model, camera)
        self._options = [mujoco.MjvOption(), mujoco.MjvOption()]
        for option, groups in zip(self._options, (SEEN, (GOAL,)), strict=True):
            option.geomgroup[:] = np.isin(np.arange(6), groups)
            option.sitegroup[:] = option.tendongroup[:] = 0
        self._renderer = _renderer(self.model, size)

    def image(self, state: State) -> np.ndarray:
        """Return the picture [h, w, 3] of one unbatched `state`, uint8."""
        mujoco: Any = importlib.import_module("mujoco")
        scene = self._renderer.scene
        self._renderer.update_scene(self._posed(self.data, self.env.render_state(state)), self.camera, self._options[0])
        shadowless = [geom for geom in scene.geoms[: scene.ngeom] if geom.type == mujoco.mjtGeom.mjGEOM_PLANE]
        wanted = self.env.render_goal(state) if self.goal else None
        if wanted is not None:
            drawn, data, still = scene.ngeom, self._posed(self.wanted, wanted), mujoco.MjvPerturb()
            mujoco.mjv_addGeoms(self.model, data, self._options[1], still, mujoco.mjtCatBit.mjCAT_ALL, scene)
            shadowless += scene.geoms[drawn : scene.ngeom]
        for geom in shadowless:
            geom.category = mujoco.mjtCatBit.mjCAT_DECOR
        return self._renderer.render()

    def _posed(self, data: Any, state: Any) -> Any:
        mujoco: Any = importlib.import_module("mujoco")
        data.qpos[:], data.mocap_pos[:], data.mocap_quat[:] = state.qpos, state.mocap_pos, state.mocap_quat
        mujoco.mj_fwdPosition(self.model, data)
        return data

    def close(self) -> None:
        """Give back what the graphics driver holds; no images after that."""
        self._renderer.close()

    def __enter__(self) -> "Scene":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def cameras(env: Env) -> list[str]:
    """Return the names of the cameras on `env`."""
    model = dressed(env.model)
    return [model.camera(number).name for number in range(model.ncam)]


def _camera(model: Any, name: str | None) -> str | int:
    names = [model.camera(number).name for number in range(model.ncam)]
    if name is None:
        return "default" if "default" in names else -1
    if name not in names:
        raise ValueError(f"no camera {name!r}; choose from {', '.join(names)}")
    return name


def _renderer(model: Any, size: tuple[int, int]) -> Any:
    height, width = size
    if min(size) < 1:
        raise ValueError(f"size must be at least (1, 1), not {tuple(size)}")
    mujoco: Any = importlib.import_module("mujoco")
    model.vis.global_.offheight, model.vis.global_.offwidth = size
    try:
        return mujoco.Renderer(model, height, width)
    except (ImportError, RuntimeError, AttributeError, mujoco.FatalError) as error:
        raise ValueError(f"{NO_GRAPHICS} ({os.environ.get('MUJOCO_GL', 'unset')}: {error})") from error


def _mujoco() -> Any:
    """Return the module `mujoco`, able to draw: where there is no display, through the first of `BACKENDS` that works."""
    seen = any(os.environ.get(name) for name in ("MUJOCO_GL", "DISPLAY", "WAYLAND_DISPLAY"))
    if platform.system() == "Linux" and not seen:
        os.environ["MUJOCO_GL"] = headless_backend()
        if "mujoco" in sys.modules:  # which chose its backend when it was imported
            drawing: Any = sys.modules[sys.modules["mujoco"].Renderer.__module__]
            importlib.reload(drawing.gl_context)
    return importlib.import_module("mujoco")


@functools.cache
def headless_backend() -> str:
    """Return the first of `BACKENDS` that draws here, tried in a process of its own, as a failed one cannot be taken back.

    Raises:
        ValueError: none does; the message says what to install.
    """
    for backend in BACKENDS:
        environment = {**os.environ, "MUJOCO_GL": backend}
        if not subprocess.run([sys.executable, "-c", PROBE], env=environment, capture_output=True).returncode:
            return backend
    raise ValueError(NO_GRAPHICS)


@functools.cache
def dressed(name: str) -> Any:
    """Return the compiled model of the MJCF `name` (in assets, or a path) with its look: to be drawn, not simulated.

    The look is the file of the same name in the folder `looks` beside the model's folder; a model without one is as it is.
    """
    mujoco: Any = importlib.import_module("mujoco")
    path = assets.mjcf(name)
    look = path.parent.parent / "looks" / path.name
    if look.is_file():
        tree = merged(_expanded(path), _expanded(look))
        model = mujoco.MjModel.from_xml_string(ET.tostring(tree, encoding="unicode"))
    else:
        model = mujoco.MjModel.from_xml_path(str(path))
    return model


def _expanded(path: Path) -> ET.Element:
    """Return the XML of `path` with its includes, which are relative to it, in place."""

    def children(element: ET.Element) -> list[ET.Element]:
        found = []
        for child in element:
            if child.tag == "include":
                found += children(ET.parse(path.parent / child.attrib["file"]).getroot())
            else:
                child[:] = children(child)
                found.append(child)
        return found

    root = ET.parse(path).getroot()
    root[:] = children(root)
    return root


def merged(model: ET.Element, look: ET.Element) -> ET.Element:
    """Return `model` in the dress of `look`, both MJCF without includes; bodies, joints and masses are the model's.

    A look's `<body name=...>` stands at its top, and what it holds is drawn in that body, as what its worldbody holds is drawn
    in the world; `bare="true"` hides what the model itself draws there. Its lights replace the model's. Of assets and cameras
    with one name the last counts. A camera may say where it looks `at`, and a geom with a mesh and a size scales the mesh.
    """
    model, look = copy.deepcopy(model), copy.deepcopy(look)
    _scale_meshes(look)
    _aim_cameras(look)
    for parent in model.iter():
        parent[:] = [child for child in parent if child.tag != "light"]
    bodies = {body.get("name"): [body] for body in model.iter("body")}
    bodies[None] = model.findall("worldbody")
    for section in look.findall("*[@bare='true']"):
        for part in bodies.get(section.get("name"), ()):
            for geom in part.findall("geom"):
                geom.set("group", str(UNSEEN))
    for section in look:
        if section.tag not in ("worldbody", "body"):
            model.append(section)
        elif section.get("name") not in bodies:
            raise ValueError(f"a look dresses the body {section.get('name')!r}, which its model does not have")
        else:
            for geom in section.iter("geom"):
                geom.set("class", geom.get("class", LOOK))
            bodies[section.get("name")][-1].extend(list(section))
    _keep_last(model)
    return model


def _keep_last(model: ET.Element) -> None:
    """Remove all but the last of the assets, and of the cameras, that share a name."""
    kept = set()
    for parent in reversed(list(model.iter())):
        for child in reversed(list(parent)):
            name = (child.tag, child.get("name"))
            if parent.tag == "asset" or child.tag == "camera":
                if name in kept:
                    parent.remove(child)
                kept.add(name)


def _aim_cameras(look: ET.Element) -> None:
    """Turn what a camera of `look` is `at` into the axes that MJCF asks for; up is up."""
    for camera in [camera for camera in look.iter("camera") if camera.get("at")]:
        place, at = (np.array(text.split(), float) for text in (camera.attrib["pos"], camera.attrib.pop("at")))
        right = np.cross(at - place, [0.0, 0.0, 1.0])
        up = np.cross(right, at - place)
        camera.set("xyaxes", " ".join(f"{number:.6g}" for number in (*right, *up)))


def _scale_meshes(look: ET.Element) -> None:
    """Give each size at which `look` draws a mesh a scaled copy of it."""
    meshes = {mesh.get("name"): mesh for mesh in look.iter("mesh")}
    copies = ET.SubElement(look, "asset")
    for geom in [geom for geom in look.iter("geom") if geom.get("mesh") and geom.get("size")]:
        scale = geom.attrib.pop("size")
        name = f"{geom.get('mesh')} {scale}"
        if name not in meshes:
            meshes[name] = ET.SubElement(
                copies, "mesh", {**meshes[geom.get("mesh")].attrib, "name": name, "scale": scale}
            )
        geom.set("mesh", name)
        geom.set("type", "mesh")
