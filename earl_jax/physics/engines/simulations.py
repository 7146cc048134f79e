"""The simulations of all lanes in MuJoCo's C engine, on threads that stay awake between the substeps of a call."""

import importlib
from typing import TYPE_CHECKING, Any

import numpy as np

from earl_jax.physics.state import Actuator, HostActuator

if TYPE_CHECKING:
    from earl_jax.physics import Simulator

STATE = ("time", "qpos", "qvel", "act")


class UnboundActuator:
    """The `HostActuator` of an `Actuator` that has no method `bind`."""

    def __init__(self, actuator: Actuator, qpos: np.ndarray, qvel: np.ndarray, ctrl: np.ndarray):
        self.actuator, self.qpos, self.qvel, self.ctrl = actuator, qpos, qvel, ctrl

    def start(self, command: np.ndarray, memory: np.ndarray) -> None:
        self.command, self.memory = command, memory

    def apply(self) -> None:
        self.ctrl[:], self.memory = self.actuator(np, self.qpos, self.qvel, self.command, self.memory)

    def finish(self) -> np.ndarray:
        return self.memory


class Simulations:
    """`count` simulations of MuJoCo's `model` on `threads` threads, of which the calling thread is one.

    MuJoCo's batch holds the state of each simulation. Its threads wait actively for 50 us after a call, so a control
    step with an actuator, which is one call for each substep, wakes them once. The actuator has `memory` numbers.
    """

    def __init__(self, simulator: "Simulator", model: Any, memory: int, count: int, threads: int):
        batch: Any = importlib.import_module("mujoco.batch")
        self.substeps, self.timestep = simulator.substeps, model.opt.timestep
        self.batch = batch.Batch(model, count, threads)
        self.outputs = [self._rows(field) for field in STATE]
        self.warmstart, self.ctrl = self._rows("qacc_warmstart"), self._rows("ctrl")
        self.qpos, self.qvel = self.outputs[1:3]
        self.sensors = self._rows("sensordata") if model.nsensordata else np.zeros((count, 0))
        self.recorded = {"qvel": np.zeros((count, self.substeps, model.nv))}
        mocap = [self._rows(field) for field in ("mocap_pos", "mocap_quat")]
        varied = [self.batch.expand(field).reshape(count, -1) for field in simulator.varied]
        before, after = [*self.outputs, self.warmstart], [*mocap, *varied]
        ends = np.cumsum([*(part.shape[1] for part in before), memory, *(part.shape[1] for part in after)])
        columns = [slice(start, end) for start, end in zip([0, *ends[:-1]], ends, strict=True)]
        self.memory, self.command = columns.pop(len(before)), slice(ends[-1], None)
        self.inputs = [(part, column) for part, column in zip(before + after, columns, strict=True) if part.size]
        self.actuator = self._bind(simulator.actuator)

    def _rows(self, field: str) -> np.ndarray:
        """Return a live view [count, k] of `field` of all simulations."""
        return self.batch.bind(field).reshape(self.batch.nsim, -1)

    def _bind(self, actuator: Any) -> HostActuator | None:
        if actuator is None:
            return None
        bind = getattr(actuator, "bind", None)
        joints = self.qpos, self.qvel, self.ctrl
        return bind(*joints) if bind else UnboundActuator(actuator, *joints)

    def advance(self, rows: np.ndarray) -> np.ndarray:
        """Return the rows [count, m] one control step after `rows [count, k]`, float32."""
        for part, columns in self.inputs:
            part[:] = rows[:, columns]
        command, memory = rows[:, self.command].astype(np.float64), rows[:, self.memory].astype(np.float64)
        if self.actuator is None:
            warmstart = self._hold(command)
        else:
            warmstart, memory = self.warmstart, self._drive(self.actuator, command, memory)
        return np.concatenate([*self.outputs, warmstart, memory, self.sensors], axis=1, dtype=np.float32)

    def _hold(self, command: np.ndarray) -> np.ndarray:
        """Simulate all substeps with the controls `command` and return the acceleration of the last one."""
        first, last = self.qvel.copy(), self.substeps - 1
        self.ctrl[:] = command
        speeds = self.batch.rollout(self.substeps, record=("qvel",), out=self.recorded)["qvel"]
        before = speeds[:, last - 1] if last else first
        return (speeds[:, last] - before) / self.timestep

    def _drive(self, actuator: HostActuator, command: np.ndarray, memory: np.ndarray) -> np.ndarray:
        """Simulate all substeps with the controls that `actuator` computes, and return its memory."""
        actuator.start(command, memory)
        for _ in range(self.substeps):
            actuator.apply()
            self.batch.step()
        return actuator.finish()
