"""The physics state of a lane, a pending control step, and the actuator between a command and MuJoCo's controls."""

import dataclasses
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np
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
        none = jnp.zeros((0,), jnp.float32)
        fields = {
            "act": none, "mocap_pos": jnp.zeros((0, 3)), "mocap_quat": jnp.zeros((0, 4)), "time": jnp.zeros(()),
            "qacc_warmstart": jnp.zeros_like(speed), "memory": none, "constants": none,
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
    once. It may also have a method `bind(qpos, qvel, ctrl)` that returns a `HostActuator`, which `c` uses instead.
    """

    def __call__(self, xp: Any, qpos: Any, qvel: Any, command: Any, memory: Any) -> tuple[Any, Any]:
        """Return controls [..., nu] and memory [..., m] from `qpos [..., nq]`, `qvel [..., nv]`, `command [..., c]`.

        `xp` is the array module, `numpy` or `jax.numpy`.
        """
        ...


class HostActuator(Protocol):
    """An actuator bound to arrays of all lanes on the host, which it reads and writes in place before every substep.

    The arrays are `qpos [n, nq]`, `qvel [n, nv]` and `ctrl [n, nu]`, float64. Results equal those of the `Actuator` up
    to rounding.
    """

    def start(self, command: np.ndarray, memory: np.ndarray) -> None:
        """Begin a control step with `command [n, c]` and `memory [n, m]`, float64."""
        ...

    def apply(self) -> None:
        """Write the controls of the next substep."""
        ...

    def finish(self) -> np.ndarray:
        """Return the memory [n, m] after the control step."""
        ...
