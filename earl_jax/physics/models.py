"""Compiled models of assets/mjcf, and a lane's state as MuJoCo's or MJX's data."""

import contextlib
import functools
import importlib
import importlib.util
import io
from typing import Any

from earl_jax import assets
from earl_jax.physics.state import PhysicsState

INVWEIGHT = "invweight:"
"""Prefix of a `<numeric>` that replaces a body's compiled inverse weight (translation, rotation); the body's name
follows."""


@functools.cache
def load_model(name: str, timestep: float | None = None) -> Any:
    """Return the compiled `mujoco.MjModel` of `assets/mjcf/<name>.xml`, with its own time step or `timestep` seconds.

    Inverse weights in the file (`INVWEIGHT`) replace the compiled ones.

    Raises:
        ValueError: there is no such file; the message lists the choices.
    """
    mujoco: Any = importlib.import_module("mujoco")
    model = mujoco.MjModel.from_xml_path(str(assets.mjcf(name)))
    for number in map(model.numeric, range(model.nnumeric)):
        if number.name.startswith(INVWEIGHT):
            model.body_invweight0[model.body(number.name.removeprefix(INVWEIGHT)).id] = number.data
    if timestep is not None:
        model.opt.timestep = timestep
    return model


def import_mjx() -> Any:
    """Return the module `mujoco.mjx`; its message about a missing Warp does not go to stdout, which can be JSON."""
    with contextlib.redirect_stdout(io.StringIO()):
        if importlib.util.find_spec("warp"):
            warp = importlib.import_module("warp")
            warp.config.log_level = warp.LOG_WARNING
        return importlib.import_module("mujoco.mjx")


def mjx_data(name: str, state: PhysicsState) -> Any:
    """Return the full `mjx.Data` of `state` in the model `name`, after forward kinematics."""
    mjx = import_mjx()
    model = mjx.put_model(load_model(name))
    fields = {field: getattr(state, field) for field in ("qpos", "qvel", "act", "mocap_pos", "mocap_quat", "time")}
    return mjx.kinematics(model, mjx.make_data(model).replace(**fields))


def mujoco_data(name: str, state: PhysicsState) -> Any:
    """Return the full `mujoco.MjData` of `state` in the model `name`, after `mj_forward`, for a renderer."""
    mujoco: Any = importlib.import_module("mujoco")
    model = load_model(name)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.act[:] = state.qpos, state.qvel, state.act
    data.mocap_pos[:], data.mocap_quat[:], data.time = state.mocap_pos, state.mocap_quat, state.time
    mujoco.mj_forward(model, data)
    return data
