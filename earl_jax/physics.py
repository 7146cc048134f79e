"""MuJoCo behind one door: what a scan carries of a simulation, and the full picture where somebody wants to look.

A lane carries MuJoCo's integration state only, never the whole `mjx.Data`. MuJoCo is imported where it is used, so that
kinematic tasks train on a machine without it.
"""

import functools
import importlib
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from earl_jax import assets


class Integration(struct.PyTreeNode):
    """MuJoCo's integration state of one lane: `qpos [nq]`, `qvel [nv]`, `act [na]`, mocap `[nmocap, 3 or 4]`, warmstart, time."""

    qpos: jax.Array
    qvel: jax.Array
    act: jax.Array
    mocap_pos: jax.Array
    mocap_quat: jax.Array
    qacc_warmstart: jax.Array
    time: jax.Array

    @classmethod
    def kinematic(cls, qpos: jax.Array) -> "Integration":
        """Return the state of a world without velocities, actuators or mocap bodies, at `qpos [nq]`."""
        rest = jnp.zeros_like(qpos)
        none = jnp.zeros((0,), qpos.dtype)
        poses = jnp.zeros((0, 3), qpos.dtype), jnp.zeros((0, 4), qpos.dtype)
        return cls(qpos, rest, none, *poses, rest, jnp.zeros((), qpos.dtype))


@functools.cache
def load_model(name: str) -> Any:
    """Return the compiled `mujoco.MjModel` of `assets/mjcf/<name>.xml`; a missing file is a ValueError with the choices."""
    mujoco: Any = importlib.import_module("mujoco")
    return mujoco.MjModel.from_xml_path(str(assets.mjcf(name)))


def mjx_data(name: str, state: Integration) -> Any:
    """Return the full `mjx.Data` of `state` in the model `name`, after forward kinematics."""
    from mujoco import mjx

    model = mjx.put_model(load_model(name))
    fields = {field: getattr(state, field) for field in ("qpos", "qvel", "act", "mocap_pos", "mocap_quat", "time")}
    return mjx.kinematics(model, mjx.make_data(model).replace(**fields))


def mujoco_data(name: str, state: Integration) -> Any:
    """Return the full `mujoco.MjData` of `state` in the model `name`, after `mj_forward`: what a renderer draws."""
    mujoco: Any = importlib.import_module("mujoco")
    model = load_model(name)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.act[:] = state.qpos, state.qvel, state.act
    data.mocap_pos[:], data.mocap_quat[:], data.time = state.mocap_pos, state.mocap_quat, state.time
    mujoco.mj_forward(model, data)
    return data
