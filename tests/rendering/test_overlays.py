"""Overlays: merging MJCF, and models whose physics an overlay leaves as it is."""

import xml.etree.ElementTree as ET

import numpy as np
import pytest

from earl_jax import assets
from earl_jax.envs import list_envs, make
from earl_jax.physics import load_model
from earl_jax.rendering.overlays import merge, with_overlay
from earl_jax.rendering.scenes import cameras

MODELS = sorted(path.stem for path in (assets.root() / "mjcf").glob("*.xml"))
FIELDS = """nq nv nu nbody nmocap qpos0 jnt_type jnt_range jnt_axis jnt_pos
    body_mass body_inertia body_pos body_quat body_parentid"""


@pytest.mark.parametrize("name", MODELS)
def test_an_overlay_leaves_the_physics_unchanged(name):
    plain, overlaid = load_model(name), with_overlay(name)
    assert overlaid.ngeom > plain.ngeom
    bodies = [[model.body(i).name for i in range(model.nbody)] for model in (plain, overlaid)]
    assert bodies[0] == bodies[1]
    for field in FIELDS.split():
        np.testing.assert_array_equal(getattr(overlaid, field), getattr(plain, field), field)


@pytest.mark.parametrize("name", list_envs())
def test_every_task_has_a_default_camera_and_a_second_one(name):
    assert "default" in cameras(make(name))
    assert len(cameras(make(name))) > 1


def mjcf(text):
    return ET.fromstring(f"<mujoco>{text}</mujoco>")


MODEL = mjcf(
    '<asset><material name="paint" rgba="1 0 0 1"/></asset>'
    '<worldbody><light/><camera name="eye"/><geom size="1"/></worldbody>'
    '<worldbody><geom size="2"/><body name="hand"><geom size="3"/></body></worldbody>'
)


def test_replace_hides_the_geoms_of_the_model_and_a_camera_looks_at_a_point():
    overlay = '<worldbody replace="true"><geom size="4"/></worldbody><body name="hand"><geom size="5"/></body>'
    merged = merge(MODEL, mjcf(overlay))
    groups = {geom.get("size"): geom.get("group") for geom in merged.iter("geom")}
    assert groups == {"1": "3", "2": "3", "3": None, "4": None, "5": None}
    assert [geom.get("size") for geom in merged.find(".//body").findall("geom")] == ["3", "5"]
    assert MODEL.find("worldbody/geom").get("group") is None
    assert merge(MODEL, mjcf('<worldbody><camera at="0 1 0"/></worldbody>')).findall(".//*[@xyaxes='1 0 0 0 0 1']")


def test_an_overlay_of_an_unknown_body_or_mesh_is_refused():
    with pytest.raises(ValueError, match="the body 'foot', but the model has none"):
        merge(MODEL, mjcf('<body name="foot"/>'))
    with pytest.raises(ValueError, match="the mesh 'cube', and has none"):
        merge(MODEL, mjcf('<worldbody><geom mesh="cube" size="1 1 1"/></worldbody>'))


def test_a_model_outside_the_package_takes_the_overlay_beside_its_folder_and_keeps_its_meshes(tmp_path):
    for folder in ("models", "overlays"):
        (tmp_path / folder).mkdir()
    model = tmp_path / "models" / "ball.xml"
    for name in ("flat", "tall"):
        tetrahedron = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
        (model.parent / f"{name}.obj").write_text(tetrahedron)
    meshes = '<asset><mesh file="flat.obj"/><mesh file="tall.obj"/></asset>'
    geoms = '<geom type="mesh" mesh="flat"/><geom type="mesh" mesh="tall"/>'
    model.write_text(f'<mujoco>{meshes}<worldbody><body name="ball">{geoms}</body></worldbody></mujoco>')
    copy = model.with_name("plain.xml")
    copy.write_text(model.read_text())
    defaults = '<default><default class="overlay"><geom type="sphere" mass="0"/></default></default>'
    overlay = tmp_path / "overlays" / "ball.xml"
    overlay.write_text(f'<mujoco>{defaults}<body name="ball"><geom size=".5"/></body></mujoco>')
    assert [with_overlay(str(path)).ngeom for path in (model, copy)] == [3, 2]
    overlay.write_text("<mujoco>")
    with pytest.raises(ValueError, match=r"ball\.xml, with the files that they include, is not XML: no element"):
        with_overlay.__wrapped__(str(model))
