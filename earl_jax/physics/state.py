"""What a lane carries of its world, and what may stand between a task's command and MuJoCo's controls."""

import dataclasses
from typing import Any, Protocol

import jax
import jax.numpy as jnp
from flax import struct


class Integration(struct.PyTreeNode):
    """MuJoCo's integration state of one lane: `qpos [nq]`, `qvel [nv]`, `act [na]`, mocap `[nmocap, 3 or 4]`, warmstart, time.

    Beside it stand what the task's drive remembers, `memory [m]`, and the lane's own values of the model fields that its
    simulator calls varied, `constants [k]`, flat and in that order.
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
    def at(cls, qpos: jax.Array, qvel: jax.Array | None = None, **others: jax.Array) -> "Integration":
        """Return the state at `qpos [nq]`, at rest unless `qvel [nv]` says otherwise, with `others` of its fields set."""
        speed = jnp.zeros_like(qpos) if qvel is None else qvel
        none = jnp.zeros((0,), jnp.float32)
        fields = {
            "act": none, "mocap_pos": jnp.zeros((0, 3)), "mocap_quat": jnp.zeros((0, 4)), "time": jnp.zeros(()),
            "qacc_warmstart": jnp.zeros_like(speed), "memory": none, "constants": none,
        }  # fmt: skip
        return cls(qpos=qpos, qvel=speed, **{**fields, **others})


OWN = ("memory", "constants")
FIELDS = tuple(field.name for field in dataclasses.fields(Integration) if field.name not in OWN)
"""The fields that MuJoCo's own data has."""


class Drive(Protocol):
    """What turns a command into each substep's controls: a motor with its own feedback. Pure, hashable, broadcasting.

    It is called before every substep, under JAX by `mjx` and `warp` and under NumPy, for all lanes at once, by `c`.
    """

    def __call__(self, xp: Any, qpos: Any, qvel: Any, command: Any, memory: Any) -> tuple[Any, Any]:
        """Return controls [..., nu] and memory [..., m] from `qpos [..., nq]`, `qvel [..., nv]`, `command [..., c]`.

        `xp` is the array module, `numpy` or `jax.numpy`.
        """
        ...
