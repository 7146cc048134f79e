"""MuJoCo's C engine in float64 on the host; its input and output are one row for each lane.

It runs on threads of this process, and beside a GPU in processes of one thread each (`host_call.workers`).
"""

import copy
import functools
import hashlib
import importlib
import threading
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import default_backend

from earl_jax.options.environment import core_count
from earl_jax.physics.host_call import service
from earl_jax.physics.state import PendingStep, PhysicsState

if TYPE_CHECKING:
    from earl_jax.physics import Simulator

CHANGED = ("time", "qpos", "qvel", "act", "qacc_warmstart", "memory")
"""The fields of a row that a control step changes; the constant fields and the command follow. MuJoCo's data has all but
the last of both."""
CONSTANT = ("mocap_pos", "mocap_quat", "constants")
ROW_COUNTS = 8
"""The largest number of numbers of rows for which a host keeps threads and data."""


def start_step(simulator: "Simulator", state: PhysicsState, command: jax.Array) -> PendingStep:
    """Return the pending control step of one lane: a ticket if the host works beside a GPU, else the row itself."""
    row = jnp.concatenate([jnp.ravel(getattr(state, field)) for field in CHANGED + CONSTANT] + [command])
    if _host_runs_beside_device():
        return PendingStep((), service.start(_register_host(simulator, state), row))
    return PendingStep(row)


def finish_step(simulator: "Simulator", state: PhysicsState, pending: PendingStep) -> tuple[PhysicsState, jax.Array]:
    """Return the result of the step that `start_step` started from `state`, as `Simulator.step` does."""
    name, ticket = _register_host(simulator, state), pending.ticket
    after = service.step(name, pending.payload) if ticket is None else service.finish(name, ticket)
    time, *rest, sensors = jnp.split(after, _field_ends(state))
    return state.replace(time=time[0], **dict(zip(CHANGED[1:], rest, strict=True))), sensors


def _host_runs_beside_device() -> bool:
    """Return whether the two parts of a step gain time: not on a CPU, nor where a callback does the work at once."""
    return default_backend() != "cpu" and service.is_foreign()


def _field_ends(state: PhysicsState) -> np.ndarray:
    return np.cumsum([getattr(state, field).size for field in CHANGED])


def _register_host(simulator: "Simulator", state: PhysicsState) -> str:
    """Register this simulator's host with XLA and return its name.

    Every process takes the same name, unless it has simulators that differ and have the same text.
    """
    serve = host_of(simulator, state.memory.size)
    width = int(_field_ends(state)[-1]) + simulator.mujoco_model().nsensordata
    digest = hashlib.blake2b(repr((simulator, state.memory.size)).encode(), digest_size=8).hexdigest()
    return service.register(f"earl_jax.{simulator.model}.{digest}", serve, width)


class Simulations:
    """`count` simulations of MuJoCo's `model` on `threads` threads, of which the calling thread is one.

    MuJoCo's batch holds the state of each simulation. Its threads wait actively for 50 us after a call, so a control
    step with an actuator, which is one call for each substep, wakes them once. The actuator has `memory` numbers.
    """

    def __init__(self, simulator: "Simulator", model: Any, memory: int, count: int, threads: int):
        batch: Any = importlib.import_module("mujoco.batch")
        self.substeps, self.timestep = simulator.substeps, model.opt.timestep
        self.actuator: Any = simulator.actuator
        self.batch = batch.Batch(model, count, threads)
        *self.outputs, self.warmstart = (self._rows(field) for field in CHANGED[:-1])
        _, self.qpos, self.qvel, _ = self.outputs
        self.ctrl, self.memory = self._rows("ctrl"), np.zeros((count, memory))
        self.sensors = self._rows("sensordata") if model.nsensordata else np.zeros((count, 0))
        self.recorded = {"qvel": np.zeros((count, self.substeps, model.nv))}
        mocap = [self._rows(field) for field in CONSTANT[:-1]]
        varied = [self.batch.expand(field).reshape(count, -1) for field in simulator.varied]
        parts = [*self.outputs, self.warmstart, self.memory, *mocap, *varied]
        ends = np.cumsum([part.shape[1] for part in parts])
        columns = [slice(end - part.shape[1], end) for part, end in zip(parts, ends, strict=True)]
        self.inputs = [(part, span) for part, span in zip(parts, columns, strict=True) if part.size]
        self.command = slice(ends[-1], None)

    def _rows(self, field: str) -> np.ndarray:
        """Return a live view [count, k] of `field` of all simulations."""
        return self.batch.bind(field).reshape(self.batch.nsim, -1)

    def advance(self, rows: np.ndarray) -> np.ndarray:
        """Return the rows [count, m] one control step after `rows [count, k]`, float32."""
        for part, columns in self.inputs:
            part[:] = rows[:, columns]
        command = rows[:, self.command].astype(np.float64)
        if self.actuator is None:
            warmstart, memory = self._hold(command), self.memory
        else:
            warmstart, memory = self.warmstart, self._drive(command)
        return np.concatenate([*self.outputs, warmstart, memory, self.sensors], axis=1, dtype=np.float32)

    def _hold(self, command: np.ndarray) -> np.ndarray:
        """Simulate all substeps with the controls `command` and return the acceleration of the last one."""
        first, last = self.qvel.copy(), self.substeps - 1
        self.ctrl[:] = command
        speeds = self.batch.rollout(self.substeps, record=("qvel",), out=self.recorded)["qvel"]
        before = speeds[:, last - 1] if last else first
        return (speeds[:, last] - before) / self.timestep

    def _drive(self, command: np.ndarray) -> np.ndarray:
        """Simulate all substeps with the controls that the actuator computes, and return its memory."""
        actuator, memory = self.actuator, self.memory
        if hasattr(actuator, "drive"):
            return actuator.drive(self.qpos, self.qvel, self.ctrl, command, memory, self.substeps, self.batch.step)
        for _ in range(self.substeps):
            self.ctrl[:], memory = actuator(np, self.qpos, self.qvel, command, memory)
            self.batch.step()
        return memory


class Host:
    """The host's part of engine `c`: it maps rows of integration state and command to rows of state and sensors.

    It has simulations for each of the last numbers of rows, on up to `threads` threads. A copy of it in another process
    works on one.
    """

    def __init__(self, simulator: "Simulator", memory: int, threads: int | None = None):
        mujoco: Any = importlib.import_module("mujoco")
        self.simulator, self.memory, self.model = simulator, memory, copy.copy(simulator.mujoco_model())
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self.threads = threads or core_count()
        self.simulations, self.lock = functools.lru_cache(ROW_COUNTS)(self._simulations), threading.Lock()

    def __reduce__(self) -> tuple:
        return Host, (self.simulator, self.memory, 1)

    def __call__(self, rows: np.ndarray) -> np.ndarray:
        """Return the output rows [n, m] for the input `rows [n, k]`, float32.

        Input: state, warm start, memory, the fields `CONSTANT`, command. Output: state, warm start, memory, sensors.
        """
        with self.lock:
            return self.simulations(len(rows)).advance(rows)

    def _simulations(self, count: int) -> Simulations:
        """Return simulations for `count` rows.

        Half of the threads work on up to one row per thread, three quarters on up to four, and all of them on more, because
        waking a thread takes longer than the work on a few rows (benchmarks/PROFILE.md).
        """
        threads = self.threads
        load = count / threads
        share = threads // 2 if load <= 1 else threads * 3 // 4 if load <= 4 else threads
        return Simulations(self.simulator, self.model, self.memory, count, max(1, min(count, share)))


host_of = functools.cache(Host)
