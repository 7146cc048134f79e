"""Overlays: geoms, cameras and lights from `assets/overlays` that are drawn with a task's model but never simulated."""

import copy
import functools
import importlib
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np

from earl_jax import assets
from earl_jax.errors import InputError

HIDDEN_GROUP = "3"
"""The group of geoms that are never drawn."""
DEFAULT_CLASS = "overlay"
"""The MJCF class of an overlay's geoms that name none."""


@functools.cache
def with_overlay(name: str) -> Any:
    """Return the compiled model of the MJCF `name` (in assets, or a path) with its overlay, for drawing only.

    The overlay is the file of the same name in the folder `overlays` beside the model's folder. A model without one is
    compiled as it is.
    """
    mujoco: Any = importlib.import_module("mujoco")
    path = assets.mjcf(name)
    overlay = path.parent.parent / "overlays" / path.name
    if not overlay.is_file():
        return mujoco.MjModel.from_xml_path(str(path))
    try:
        tree = merge(_with_includes(path), _with_includes(overlay))
    except ET.ParseError as error:
        raise InputError(f"{path} or {overlay}, with the files that they include, is not XML: {error}") from error
    spec = mujoco.MjSpec.from_string(ET.tostring(tree, encoding="unicode"))
    spec.modelfiledir = str(path.parent)  # for the files of meshes and textures
    return spec.compile()


def _with_includes(path: Path) -> ET.Element:
    """Return the XML of `path` with its includes, which are relative to it, replaced by their contents."""
    root = ET.parse(path).getroot()
    for parent in root.iter():
        while (include := parent.find("include")) is not None:
            index = list(parent).index(include)
            parent[index : index + 1] = list(ET.parse(path.parent / include.get("file", "")).getroot())
    return root


def merge(model: ET.Element, overlay: ET.Element) -> ET.Element:
    """Return `model` merged with `overlay`, both MJCF without includes; bodies, joints and masses are the model's.

    An overlay's `<body name=...>` is a top-level element. Its contents are drawn in the model's body of that name, and
    those of its worldbody in the model's worldbody. `replace="true"` on either hides the model's own geoms there. The
    overlay's lights replace the model's. Of assets and cameras with the same name the last one counts. The attribute
    `at` of a camera is the point that it looks at. The size of a geom with a mesh scales the mesh.

    Raises:
        ValueError: the model has no body of that name.
    """
    model, overlay = copy.deepcopy((model, overlay))
    _scale_meshes(overlay)
    _aim_cameras(overlay)
    for parent in model.iter():
        parent[:] = [child for child in parent if child.tag != "light"]
    bodies = {body.get("name"): [body] for body in model.iter("body")}
    bodies[None] = model.findall("worldbody")
    for section in overlay.findall("*[@replace='true']"):
        for geom in (geom for body in bodies.get(section.get("name"), []) for geom in body.findall("geom")):
            geom.set("group", HIDDEN_GROUP)
    for section in overlay:
        if section.tag not in ("worldbody", "body"):
            model.append(section)
        elif section.get("name") not in bodies:
            raise InputError(f"the overlay has the body {section.get('name')!r}, but the model has none of that name")
        else:
            for geom in section.iter("geom"):
                geom.set("class", geom.get("class", DEFAULT_CLASS))
            bodies[section.get("name")][-1].extend(list(section))
    _keep_last(model)
    return model


def _keep_last(model: ET.Element) -> None:
    """Remove all but the last of the assets, and of the cameras, that share a name."""
    kept = set()
    for parent in reversed(list(model.iter())):
        for child in reversed(list(parent)):
            name = (child.tag, child.get("name"))
            if name[1] and (parent.tag == "asset" or child.tag == "camera"):
                if name in kept:
                    parent.remove(child)
                kept.add(name)


def _aim_cameras(overlay: ET.Element) -> None:
    """Replace the attribute `at` of cameras, the point they look at, by the axes that MJCF needs; z points up."""
    for camera in [camera for camera in overlay.iter("camera") if camera.get("at")]:
        position, at = (np.array(text.split(), float) for text in (camera.get("pos", "0 0 0"), camera.attrib.pop("at")))
        right = np.cross(at - position, [0.0, 0.0, 1.0])
        up = np.cross(right, at - position)
        camera.set("xyaxes", " ".join(f"{number:.6g}" for number in (*right, *up)))


def _scale_meshes(overlay: ET.Element) -> None:
    """Add a scaled copy of a mesh for each size at which `overlay` draws it."""
    meshes = {mesh.get("name"): mesh for mesh in overlay.iter("mesh")}
    copies = ET.SubElement(overlay, "asset")
    for geom in [geom for geom in overlay.iter("geom") if geom.get("mesh") and geom.get("size")]:
        scale = geom.attrib.pop("size")
        name = f"{geom.get('mesh')} {scale}"
        if geom.get("mesh") not in meshes:
            raise InputError(f"the overlay scales the mesh {geom.get('mesh')!r}, and has none of that name")
        if name not in meshes:
            original = meshes[geom.get("mesh")].attrib
            meshes[name] = ET.SubElement(copies, "mesh", {**original, "name": name, "scale": scale})
        geom.set("mesh", name)
        geom.set("type", "mesh")
