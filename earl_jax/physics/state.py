"""The physics state of a lane, a pending control step, and the actuator between a command and MuJoCo's controls."""

import dataclasses
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
from flax import struct


class PhysicsState(struct.PyTreeNode):
    """MuJoCo's integration state of one lane: `qpos [nq]`, `qvel [nv]`, `act [na]`, mocap, warm start and time.

    `mocap_pos [nmocap, 3]`, `mocap_quat [nmocap, 4]`. `memory [m]` is the state of the task's actuator. `constants [k]`
    are this lane's values of the model fields `Simulator.varied`, flat and in that order.
    """

    qpos: jax.Array
    qvel: jax.Array
    act: jax.Array
    mocap_pos: jax.Array
    mocap_quat: jax.Array
    qacc_warmstart: jax.Array
    time: jax.Array
    memory: jax.Array
    constants: jax.Array

    @classmethod
    def at(cls, qpos: jax.Array, qvel: jax.Array | None = None, **others: jax.Array) -> "PhysicsState":
        """Return the state at `qpos [nq]` with `qvel [nv]` and the fields `others`; the rest is 0.

        By default `qvel` is 0 [nq], for a model without ball and free joints, which have more coordinates than speeds.
        """
        speed = jnp.zeros_like(qpos) if qvel is None else qvel
        fields = {
            "act": jnp.zeros(0), "mocap_pos": jnp.zeros((0, 3)), "mocap_quat": jnp.zeros((0, 4)), "time": jnp.zeros(()),
            "qacc_warmstart": jnp.zeros_like(speed), "memory": jnp.zeros(0), "constants": jnp.zeros(0),
        }  # fmt: skip
        return cls(qpos=qpos, qvel=speed, **{**fields, **others})


class PendingStep(NamedTuple):
    """A control step between `start_step` and `finish_step`.

    `payload` is the tree of arrays that `finish_step` needs. `ticket [1]`, int32, identifies work that the host does
    concurrently with a GPU; it is None if the step has no such work.
    """

    payload: Any
    ticket: jax.Array | None = None


FIELDS = tuple(field.name for field in dataclasses.fields(PhysicsState) if field.name not in ("memory", "constants"))
"""The fields that MuJoCo's data also has."""


class Actuator(Protocol):
    """Converts a command into controls of each substep, like a motor with feedback; pure, hashable, broadcasting.

    It is called before every substep: by `mjx` and `warp` with JAX arrays, by `c` with NumPy arrays of all lanes at
    once. It may also have a method `drive(qpos, qvel, ctrl, command, memory, substeps, step)` for `c`, with an equal result
    up to rounding: it writes `ctrl [n, nu]` before each of `substeps` calls of `step()`, which change `qpos [n, nq]` and
    `qvel [n, nv]`, and returns the memory [n, m]; all arrays are float64.
    """

    def __call__(self, xp: Any, qpos: Any, qvel: Any, command: Any, memory: Any) -> tuple[Any, Any]:
        """Return controls [..., nu] and memory [..., m] from `qpos [..., nq]`, `qvel [..., nv]`, `command [..., c]`.

        `xp` is the array module, `numpy` or `jax.numpy`.
        """
        ...
