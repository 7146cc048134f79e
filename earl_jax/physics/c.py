"""MuJoCo's C engine in float64 behind one callback, which takes and returns one row a lane."""

import copy
import functools
import importlib
import os
import threading
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.physics.state import Integration

if TYPE_CHECKING:
    from earl_jax.physics import Simulator

ORDER = ("time", "qpos", "qvel", "act", "qacc_warmstart", "memory")
"""The fields of a row that a control step changes; mocap, constants and command follow."""
HELD = ("mocap_pos", "mocap_quat", "constants")


def step(simulator: "Simulator", state: Integration, command: jax.Array) -> tuple[Integration, jax.Array]:
    """Return what `Simulator.step` promises, from one call of the host for all lanes."""
    row = jnp.concatenate([jnp.ravel(getattr(state, field)) for field in ORDER + HELD] + [command])
    widths = np.cumsum([getattr(state, field).size for field in ORDER])
    out = jax.ShapeDtypeStruct((widths[-1] + simulator.mujoco_model().nsensordata,), jnp.float32)
    after = jax.pure_callback(host_of(simulator, state.memory.size), out, row, vmap_method="broadcast_all")
    time, *rest, sensors = jnp.split(after, widths)
    return state.replace(time=time[0], **dict(zip(ORDER[1:], rest, strict=True))), sensors


class Host:
    """The host's half of engine `c`: rows of integration state and command in, rows of state and sensors out.

    All rows go through one call of `mujoco.rollout` (one a substep where a drive has its say before each), on a pool of as
    many threads as this process may use cores, or half of them for few rows, where waking a thread costs more than it does.
    """

    def __init__(self, simulator: "Simulator", memory: int):
        mujoco: Any = importlib.import_module("mujoco")
        rollout: Any = importlib.import_module("mujoco.rollout")
        self.simulator, self.model = simulator, copy.copy(simulator.mujoco_model())
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        model, bits = self.model, mujoco.mjtState
        self.spec = bits.mjSTATE_MOCAP_POS | bits.mjSTATE_MOCAP_QUAT | bits.mjSTATE_CTRL
        self.physics = 1 + model.nq + model.nv + model.na
        self.position, self.velocity = slice(1, 1 + model.nq), slice(1 + model.nq, 1 + model.nq + model.nv)
        self.widths = np.cumsum([self.physics, model.nv, memory, 7 * model.nmocap, simulator.variation_size])
        self.cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        self.data = [mujoco.MjData(model) for _ in range(self.cores)]
        self.pools = {count: rollout.Rollout(nthread=count) for count in {self.cores, self._few}}
        self.models: list[Any] = []
        self.constants = np.zeros((0, simulator.variation_size))
        self.lock = threading.Lock()

    @property
    def _few(self) -> int:
        return max(1, self.cores // 2)

    def __call__(self, rows: np.ndarray) -> np.ndarray:
        """Return rows [..., state + warmstart + memory + sensors] for rows [..., state + warmstart + memory + held + command]."""
        shape, rows = rows.shape[:-1], np.asarray(rows, np.float64).reshape(-1, rows.shape[-1])
        state, warmstart, memory, mocap, constants, command = np.split(rows, self.widths, axis=1)
        with self.lock:
            models = self._models(constants)
            if self.simulator.drive is None:
                after = self._roll(models, state, warmstart, mocap, command, self.simulator.substeps)
            for _ in range(self.simulator.substeps if self.simulator.drive else 0):
                joints, speeds = state[:, self.position], state[:, self.velocity]
                ctrl, memory = self.simulator.controls(np, joints, speeds, command, memory)
                state, warmstart, _ = after = self._roll(models, state, warmstart, mocap, ctrl, 1)
        state, warmstart, sensors = after
        return np.concatenate([state, warmstart, memory, sensors], axis=1, dtype=np.float32).reshape(*shape, -1)

    def _roll(
        self, models: list, state, warmstart, mocap, ctrl, steps: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return state, acceleration and sensors of the last of `steps` steps."""
        count, last = len(state), steps - 1
        states = np.empty((count, steps, self.physics))
        sensors = np.empty((count, steps, self.model.nsensordata))
        held = np.repeat(np.concatenate([ctrl, mocap], axis=1)[:, None], steps, axis=1)
        threads = self.cores if count > 4 * self.cores else self._few
        start = np.ascontiguousarray(state)
        self.pools[threads].rollout(
            models, self.data[:threads], start, held, control_spec=self.spec, skip_checks=True, nstep=steps,
            initial_warmstart=np.ascontiguousarray(warmstart), state=states, sensordata=sensors,
        )  # fmt: skip
        before = states[:, last - 1] if last else start
        acceleration = (states[:, last, self.velocity] - before[:, self.velocity]) / self.model.opt.timestep
        return states[:, last], acceleration, sensors[:, last]

    def _models(self, constants: np.ndarray) -> list[Any]:
        """Return a model a row: one for all, or each with its own `constants [n, k]`, written only where they changed."""
        if not self.simulator.varied:
            return [self.model] * len(constants)
        missing = len(constants) - len(self.models)
        if missing > 0:
            self.models += [copy.copy(self.model) for _ in range(missing)]
            self.constants = np.vstack([self.constants, np.full((missing, constants.shape[1]), np.nan)])
        known = self.constants[: len(constants)]
        for lane in np.flatnonzero((known != constants).any(axis=1)):
            for field, value in self.simulator.variation(constants[lane]).items():
                getattr(self.models[lane], field)[:] = value
        known[:] = constants
        return self.models[: len(constants)]


host_of = functools.cache(Host)
