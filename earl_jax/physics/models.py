"""Compiled models of assets/mjcf, and a lane's state as MuJoCo's data."""

import contextlib
import functools
import importlib
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from earl_jax import assets
from earl_jax.errors import InputError
from earl_jax.physics.engine_choice import has_warp
from earl_jax.physics.state import PhysicsState

INVWEIGHT = "invweight:"
"""Prefix of a `<numeric>` that replaces a body's compiled inverse weight (translation, rotation); the body's name
follows."""
REFERENCE = "reference_timestep"
"""A `<numeric>`: the time step, in seconds, for which the constants of the file hold. A longer one adapts them."""
GROWTH = "armature_growth"
"""A `<numeric>` beside `REFERENCE`: the armature that each of the first joints gains for each second of longer time
step."""
_READ: dict[str, tuple[Path, int]] = {}
"""The file of each compiled model, and when it was last changed."""


def require_unchanged(name: str) -> None:
    """Raise an InputError if the file of the model `name` has changed since this process compiled it."""
    path, changed = _READ.get(name, (Path(), 0))
    if path.is_file():
        assets.require_unchanged(path, changed)


@functools.cache
def load_model(name: str, timestep: float | None = None) -> Any:
    """Return the compiled `mujoco.MjModel` of `assets/mjcf/<name>.xml`, with its own time step or `timestep` seconds.

    Geoms that only pictures need are left out. Inverse weights in the file (`INVWEIGHT`) replace the compiled ones. A
    model with a time step of `REFERENCE` behaves nearly the same at longer time steps.

    Raises:
        ValueError: there is no such file (the message lists the choices), or MuJoCo cannot compile it.
    """
    mujoco: Any = importlib.import_module("mujoco")
    path = assets.mjcf(name)
    _READ.setdefault(name, (path.absolute(), path.stat().st_mtime_ns))
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        spec.compiler.discardvisual = True
        model = spec.compile()
    except ValueError as error:
        raise InputError(f"{path} is not a model that MuJoCo can compile: {' '.join(str(error).split())}") from error
    numbers = {number.name: number.data for number in map(model.numeric, range(model.nnumeric))}
    for key, data in numbers.items():
        if key.startswith(INVWEIGHT):
            model.body_invweight0[model.body(key.removeprefix(INVWEIGHT)).id] = data
    if timestep is not None:
        model.opt.timestep = timestep
    if REFERENCE in numbers:
        _adapt_to_timestep(model, float(numbers[REFERENCE][0]), numbers.get(GROWTH, ()))
    return model


def _adapt_to_timestep(model: Any, reference: float, growth: Sequence[float]) -> None:
    """Keep the motion of the time step `reference` at a longer one, with the armature's `growth` as in `GROWTH`.

    MuJoCo raises time constants of constraints to two time steps, which makes constraints softer; a smaller damping
    ratio keeps their stiffness. It also applies joint damping at the end of a step, after the constraints, so with a
    longer step a damped joint yields less to them; more armature compensates for this.
    """
    shortest, excess = 2.0 * model.opt.timestep, max(0.0, model.opt.timestep - reference)
    for solref in (model.eq_solref, model.pair_solref, model.jnt_solref):
        raised = (solref[:, 0] > 0.0) & (solref[:, 0] < shortest)
        solref[raised, 1] *= solref[raised, 0] / shortest
        solref[raised, 0] = shortest
    model.dof_armature[: len(growth)] += excess * np.asarray(growth)


def import_mjx() -> Any:
    """Return the module `mujoco.mjx`; keep its message about a missing Warp off stdout, which can be JSON."""
    with contextlib.redirect_stdout(io.StringIO()):
        if has_warp():
            warp = importlib.import_module("warp")
            warp.config.log_level = warp.LOG_WARNING
        return importlib.import_module("mujoco.mjx")


def mujoco_data(name: str, state: PhysicsState) -> Any:
    """Return the full `mujoco.MjData` of `state` in the simulated model `name`, after `mj_forward`."""
    mujoco: Any = importlib.import_module("mujoco")
    model = load_model(name)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.act[:] = state.qpos, state.qvel, state.act
    data.mocap_pos[:], data.mocap_quat[:], data.time = state.mocap_pos, state.mocap_quat, state.time
    mujoco.mj_forward(model, data)
    return data
