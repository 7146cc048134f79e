"""MuJoCo's C engine in float64 on the host's threads; its input and output are one row for each lane."""

import copy
import functools
import hashlib
import importlib
import threading
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.physics.engine_choice import usable_cores
from earl_jax.physics.host_call import service
from earl_jax.physics.state import PendingStep, PhysicsState

if TYPE_CHECKING:
    from earl_jax.physics import Simulator

CHANGED = ("time", "qpos", "qvel", "act", "qacc_warmstart", "memory")
"""The fields of a row that a control step changes; the constant fields and the command follow."""
CONSTANT = ("mocap_pos", "mocap_quat", "constants")


def start_step(simulator: "Simulator", state: PhysicsState, command: jax.Array) -> PendingStep:
    """Return the pending control step of one lane: a ticket if the host works beside a GPU, else the row itself."""
    row = jnp.concatenate([jnp.ravel(getattr(state, field)) for field in CHANGED + CONSTANT] + [command])
    if _host_runs_beside_device():
        return PendingStep((), service.start(_register_host(simulator, state)[0], row))
    return PendingStep(row)


def finish_step(simulator: "Simulator", state: PhysicsState, pending: PendingStep) -> tuple[PhysicsState, jax.Array]:
    """Return the result of the step that `start_step` started from `state`, as `Simulator.step` does."""
    name, width = _register_host(simulator, state)
    ticket = pending.ticket
    after = service.step(name, pending.payload, width) if ticket is None else service.finish(name, ticket, width)
    time, *rest, sensors = jnp.split(after, _field_ends(state))
    return state.replace(time=time[0], **dict(zip(CHANGED[1:], rest, strict=True))), sensors


def _host_runs_beside_device() -> bool:
    return jax.default_backend() != "cpu"


def _field_ends(state: PhysicsState) -> np.ndarray:
    return np.cumsum([getattr(state, field).size for field in CHANGED])


def _register_host(simulator: "Simulator", state: PhysicsState) -> tuple[str, int]:
    """Register this simulator's host with XLA; return its name, the same in every process, and its output width."""
    serve = host_of(simulator, state.memory.size)
    width = int(_field_ends(state)[-1]) + simulator.mujoco_model().nsensordata
    digest = hashlib.blake2b(repr((simulator, state.memory.size)).encode(), digest_size=8).hexdigest()
    name = f"earl_jax.{simulator.model}.{digest}"
    service.register(name, serve, width)
    return name, width


class Host:
    """The host's part of engine `c`: it maps rows of integration state and command to rows of state and sensors.

    Each stream has its own worker pool, and the pools share the cores of this process.
    """

    def __init__(self, simulator: "Simulator", memory: int):
        mujoco: Any = importlib.import_module("mujoco")
        self.simulator, self.model = simulator, copy.copy(simulator.mujoco_model())
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        model, bits = self.model, mujoco.mjtState
        self.spec = bits.mjSTATE_MOCAP_POS | bits.mjSTATE_MOCAP_QUAT | bits.mjSTATE_CTRL
        self.physics = 1 + model.nq + model.nv + model.na
        self.position, self.velocity = slice(1, 1 + model.nq), slice(1 + model.nq, 1 + model.nq + model.nv)
        self.widths = np.cumsum([self.physics, model.nv, memory, 7 * model.nmocap, simulator.variation_size])
        self.worker_pools: dict[int, WorkerPool] = {}
        self.lock = threading.Lock()

    def __call__(self, rows: np.ndarray, stream: int = 0) -> np.ndarray:
        """Return the output rows [n, m] for the input `rows [n, k]`, float32.

        Input: state, warm start, memory, the fields `CONSTANT`, command. Output: state, warm start, memory, sensors.
        """
        with self.lock:
            if stream not in self.worker_pools:
                streams = [*self.worker_pools, stream]
                threads = max(1, usable_cores() // len(streams))
                self.worker_pools = {key: WorkerPool(self, threads) for key in streams}
            worker_pool = self.worker_pools[stream]
        return worker_pool.advance(rows)


class WorkerPool:
    """The threads of one stream, with their data and models.

    One call of `mujoco.rollout` simulates all rows, or one call for each substep if an actuator computes its controls.
    Waking a thread takes longer than the work on a few rows. So half of the threads work on up to one row per thread of
    the pool, three quarters on up to four, and all of them on more. These limits are four times higher for the short
    calls with an actuator. They were measured on 16 cores (benchmarks/PROFILE.md).
    """

    def __init__(self, host: Host, threads: int):
        mujoco: Any = importlib.import_module("mujoco")
        rollout: Any = importlib.import_module("mujoco.rollout")
        self.host, self.threads = host, threads
        self.half, self.three_quarters = max(1, threads // 2), max(1, threads * 3 // 4)
        self.data = [mujoco.MjData(host.model) for _ in range(threads)]
        self.pools = {count: rollout.Rollout(nthread=count) for count in {self.half, self.three_quarters, self.threads}}
        self.models: list[Any] = []
        self.constants = np.zeros((0, host.simulator.variation_size))
        self.lock = threading.Lock()

    def advance(self, rows: np.ndarray) -> np.ndarray:
        """Return the rows [n, m] one control step after `rows [n, k]`, float32."""
        simulator = self.host.simulator
        state, warmstart, memory, mocap, constants, command = np.split(
            rows.astype(np.float64), self.host.widths, axis=1
        )
        with self.lock:
            models = self._models(constants)
            if simulator.actuator is None:
                after = self._roll(models, state, warmstart, mocap, command, simulator.substeps)
            for _ in range(simulator.substeps if simulator.actuator else 0):
                joints, speeds = state[:, self.host.position], state[:, self.host.velocity]
                ctrl, memory = simulator.controls(np, joints, speeds, command, memory)
                state, warmstart, _ = after = self._roll(models, state, warmstart, mocap, ctrl, 1)
        state, warmstart, sensors = after
        return np.concatenate([state, warmstart, memory, sensors], axis=1, dtype=np.float32)

    def _roll(
        self, models: list, state, warmstart, mocap, ctrl, steps: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the state, acceleration and sensors of the last of `steps` physics steps."""
        host, count, last = self.host, len(state), steps - 1
        states = np.empty((count, steps, host.physics))
        sensors = np.empty((count, steps, host.model.nsensordata))
        held = np.repeat(np.concatenate([ctrl, mocap], axis=1)[:, None], steps, axis=1)
        threads = self._threads(count)
        start = np.ascontiguousarray(state)
        self.pools[threads].rollout(
            models, self.data[:threads], start, held, control_spec=host.spec, skip_checks=True, nstep=steps,
            initial_warmstart=np.ascontiguousarray(warmstart), state=states, sensordata=sensors,
        )  # fmt: skip
        before = states[:, last - 1] if last else start
        acceleration = (states[:, last, host.velocity] - before[:, host.velocity]) / host.model.opt.timestep
        return states[:, last], acceleration, sensors[:, last]

    def _threads(self, rows: int) -> int:
        """Return the number of threads that work on `rows`."""
        load = rows / self.threads / (4 if self.host.simulator.actuator else 1)
        return self.half if load <= 1 else self.three_quarters if load <= 4 else self.threads

    def _models(self, constants: np.ndarray) -> list[Any]:
        """Return a model for each row: a shared one, or one with its own `constants [n, k]`, written on change."""
        if not self.host.simulator.varied:
            return [self.host.model] * len(constants)
        missing = len(constants) - len(self.models)
        if missing > 0:
            self.models += [copy.copy(self.host.model) for _ in range(missing)]
            self.constants = np.vstack([self.constants, np.full((missing, constants.shape[1]), np.nan)])
        known = self.constants[: len(constants)]
        for lane in np.flatnonzero((known != constants).any(axis=1)):
            for field, value in self.host.simulator.variation(constants[lane]).items():
                getattr(self.models[lane], field)[:] = value
        known[:] = constants
        return self.models[: len(constants)]


host_of = functools.cache(Host)
