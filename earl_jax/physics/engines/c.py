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

from earl_jax.machine import own_cores
from earl_jax.physics.engines.simulations import Simulations
from earl_jax.physics.host_call import service
from earl_jax.physics.state import PendingStep, PhysicsState

if TYPE_CHECKING:
    from earl_jax.physics import Simulator

CHANGED = ("time", "qpos", "qvel", "act", "qacc_warmstart", "memory")
"""The fields of a row that a control step changes; the constant fields and the command follow."""
CONSTANT = ("mocap_pos", "mocap_quat", "constants")
ROW_COUNTS = 8
"""The largest number of numbers of rows for which a worker pool keeps threads and data."""


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
        self.simulator, self.memory, self.model = simulator, memory, copy.copy(simulator.mujoco_model())
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self.worker_pools: dict[int, WorkerPool] = {}
        self.lock = threading.Lock()

    def __call__(self, rows: np.ndarray, stream: int = 0) -> np.ndarray:
        """Return the output rows [n, m] for the input `rows [n, k]`, float32.

        Input: state, warm start, memory, the fields `CONSTANT`, command. Output: state, warm start, memory, sensors.
        """
        with self.lock:
            if stream not in self.worker_pools:
                streams = [*self.worker_pools, stream]
                threads = max(1, len(own_cores()) // len(streams))
                self.worker_pools = {key: WorkerPool(self, threads) for key in streams}
            worker_pool = self.worker_pools[stream]
        return worker_pool.advance(rows)

    def simulations(self, count: int, threads: int) -> Simulations:
        """Return `count` new simulations on `threads` threads."""
        return Simulations(self.simulator, self.model, self.memory, count, threads)


class WorkerPool:
    """The threads of one stream: a set of simulations for each of the last numbers of rows."""

    def __init__(self, host: Host, threads: int):
        self.host, self.threads = host, threads
        self.simulations: dict[int, Simulations] = {}
        self.lock = threading.Lock()

    def advance(self, rows: np.ndarray) -> np.ndarray:
        """Return the rows [n, m] one control step after `rows [n, k]`, float32."""
        count = len(rows)
        with self.lock:
            if count not in self.simulations:
                if len(self.simulations) == ROW_COUNTS:
                    del self.simulations[next(iter(self.simulations))]
                self.simulations[count] = self.host.simulations(count, self._threads(count))
            return self.simulations[count].advance(rows)

    def _threads(self, rows: int) -> int:
        """Return the number of threads that work on `rows`, of which the calling thread is one.

        Half of the threads work on up to one row per thread of the pool, three quarters on up to four, and all of them
        on more, because waking a thread takes longer than the work on a few rows (benchmarks/PROFILE.md).
        """
        load = rows / self.threads
        share = self.threads // 2 if load <= 1 else self.threads * 3 // 4 if load <= 4 else self.threads
        return max(1, min(rows, share))


host_of = functools.cache(Host)
