"""MuJoCo's C engine in float64 on the host's threads, which takes and returns one row a lane."""

import copy
import functools
import hashlib
import importlib
import os
import threading
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.physics import service
from earl_jax.physics.state import Integration

if TYPE_CHECKING:
    from earl_jax.physics import Simulator

ORDER = ("time", "qpos", "qvel", "act", "qacc_warmstart", "memory")
"""The fields of a row that a control step changes; mocap, constants and command follow."""
HELD = ("mocap_pos", "mocap_quat", "constants")


def launch(simulator: "Simulator", state: Integration, command: jax.Array) -> jax.Array:
    """Return the control step of one lane on its way: a ticket where the host works beside a GPU, else the row itself."""
    row = jnp.concatenate([jnp.ravel(getattr(state, field)) for field in ORDER + HELD] + [command])
    return service.launch(_served(simulator, state)[0], row) if _beside() else row


def land(simulator: "Simulator", state: Integration, flight: jax.Array) -> tuple[Integration, jax.Array]:
    """Return what `Simulator.step` promises of the step that `launch` began from `state`."""
    name, width = _served(simulator, state)
    after = (service.land if _beside() else service.step)(name, flight, width)
    time, *rest, sensors = jnp.split(after, _ends(state))
    return state.replace(time=time[0], **dict(zip(ORDER[1:], rest, strict=True))), sensors


def _beside() -> bool:
    return jax.default_backend() != "cpu"


def _ends(state: Integration) -> np.ndarray:
    return np.cumsum([getattr(state, field).size for field in ORDER])


def _served(simulator: "Simulator", state: Integration) -> tuple[str, int]:
    """Return the name under which XLA finds this simulator's host, the same in every process, and the width of its answers."""
    serve, width = host_of(simulator, state.memory.size), int(_ends(state)[-1]) + simulator.mujoco_model().nsensordata
    digest = hashlib.blake2b(repr((simulator, state.memory.size)).encode(), digest_size=8).hexdigest()
    name = f"earl_jax.{simulator.model}.{digest}"
    service.register(name, serve, width)
    return name, width


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Host:
    """The host's half of engine `c`: rows of integration state and command in, rows of state and sensors out.

    Every stream that asks has a crew of its own, and the crews share the cores of this process.
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
        self.crews: dict[int, Crew] = {}
        self.lock = threading.Lock()

    def __call__(self, rows: np.ndarray, stream: int = 0) -> np.ndarray:
        """Return rows [n, state + warmstart + memory + sensors] for rows [n, state + warmstart + memory + held + command]."""
        with self.lock:
            if stream not in self.crews:
                streams = [*self.crews, stream]
                self.crews = {one: Crew(self, max(1, cores() // len(streams))) for one in streams}
            crew = self.crews[stream]
        return crew.advance(rows)


class Crew:
    """Threads, and the data and models they work on, for the rows of one stream.

    All rows go through one call of `mujoco.rollout` (one a substep where a drive has its say before each). Waking a thread
    costs more than it does for few rows: half the threads take as many rows as there are threads, three quarters four times
    as many, and short calls for a drive half as many again, as measured on 16 cores (benchmarks/PROFILE.md).
    """

    def __init__(self, host: Host, threads: int):
        mujoco: Any = importlib.import_module("mujoco")
        rollout: Any = importlib.import_module("mujoco.rollout")
        self.host, self.threads = host, threads
        self.half, self.most = max(1, threads // 2), max(1, threads * 3 // 4)
        self.data = [mujoco.MjData(host.model) for _ in range(threads)]
        self.pools = {count: rollout.Rollout(nthread=count) for count in {self.half, self.most, self.threads}}
        self.models: list[Any] = []
        self.constants = np.zeros((0, host.simulator.variation_size))
        self.lock = threading.Lock()

    def advance(self, rows: np.ndarray) -> np.ndarray:
        """Return the rows [n, m] that follow `rows [n, k]` one control step later, float32."""
        simulator = self.host.simulator
        state, warmstart, memory, mocap, constants, command = np.split(
            rows.astype(np.float64), self.host.widths, axis=1
        )
        with self.lock:
            models = self._models(constants)
            if simulator.drive is None:
                after = self._roll(models, state, warmstart, mocap, command, simulator.substeps)
            for _ in range(simulator.substeps if simulator.drive else 0):
                joints, speeds = state[:, self.host.position], state[:, self.host.velocity]
                ctrl, memory = simulator.controls(np, joints, speeds, command, memory)
                state, warmstart, _ = after = self._roll(models, state, warmstart, mocap, ctrl, 1)
        state, warmstart, sensors = after
        return np.concatenate([state, warmstart, memory, sensors], axis=1, dtype=np.float32)

    def _roll(
        self, models: list, state, warmstart, mocap, ctrl, steps: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return state, acceleration and sensors of the last of `steps` steps."""
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
        """Return how many threads work on `rows`."""
        load = rows / self.threads / (4 if self.host.simulator.drive else 1)
        return self.half if load <= 1 else self.most if load <= 4 else self.threads

    def _models(self, constants: np.ndarray) -> list[Any]:
        """Return a model a row: one for all, or each with its own `constants [n, k]`, written only where they changed."""
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
