"""MuJoCo behind one door: integration state in, integration state out, on any of three engines.

A lane carries MuJoCo's integration state only, never the whole `mjx.Data`; what a task sees of the world are the sensors of
its MJCF, read as the last substep began (so they lag the state by one substep, as in the original environments).
MuJoCo is imported where it is used, so that kinematic tasks train on a machine without it.
"""

import contextlib
import copy
import dataclasses
import functools
import importlib
import importlib.util
import io
import os
import threading
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from earl_jax import assets

ENGINES = ("mjx", "warp", "c")
FASTEST = {"cpu": "c", "gpu": "c"}
"""The engine `auto` takes on a backend, by benchmarks/results/physics; elsewhere (TPU) it is mjx."""
EXTRAS = {"mjx": ("mujoco.mjx", ""), "warp": ("warp", "[warp]"), "c": ("mujoco", "")}
WARP_CONTACTS, WARP_ROWS = 1 << 15, 256
"""Room that Warp gets: contacts of all lanes together, constraint rows of one. Where it runs out the state becomes NaN."""
INVWEIGHT = "invweight:"
"""A `<numeric>` of this name and a body's replaces the body's compiled inverse weight (translation, rotation)."""


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


FIELDS = tuple(field.name for field in dataclasses.fields(Integration))


def resolve(engine: str) -> str:
    """Return the engine that `engine` stands for here: itself, or for `auto` the fastest measured on this backend.

    Raises:
        ValueError: the engine is unknown or not installed; the message names the choices or the extra that brings it.
    """
    if engine == "auto":
        return FASTEST.get(jax.default_backend(), "mjx")
    if engine not in ENGINES:
        raise ValueError(f"unknown physics engine {engine!r}; choose from auto, {', '.join(ENGINES)}")
    module, extra = EXTRAS[engine]
    if importlib.util.find_spec(module.partition(".")[0]) is None:
        raise ValueError(f"physics engine {engine!r} is not installed; get it with: pip install 'earl-jax{extra}'")
    return engine


@functools.cache
def load_model(name: str, timestep: float | None = None) -> Any:
    """Return the compiled `mujoco.MjModel` of `assets/mjcf/<name>.xml`, at its own time step or at `timestep` seconds.

    A missing file is a ValueError with the choices. Inverse weights that the file gives are written over compiled ones.
    """
    mujoco: Any = importlib.import_module("mujoco")
    model = mujoco.MjModel.from_xml_path(str(assets.mjcf(name)))
    for number in map(model.numeric, range(model.nnumeric)):
        if number.name.startswith(INVWEIGHT):
            model.body_invweight0[model.body(number.name.removeprefix(INVWEIGHT)).id] = number.data
    if timestep is not None:
        model.opt.timestep = timestep
    return model


@dataclasses.dataclass(frozen=True)
class Simulator:
    """One MJCF `model` advanced by `substeps` of `timestep` seconds a control step on `engine` (one of `ENGINES`)."""

    model: str
    timestep: float
    substeps: int
    engine: str

    def step(self, state: Integration, ctrl: jax.Array) -> tuple[Integration, jax.Array]:
        """Return the state one control step later under `ctrl [nu]`, and the sensors [nsensordata] of its last substep.

        Pure and unbatched: under vmap `mjx` and `warp` run all lanes in one program, `c` in one threaded call.
        """
        advance = _step_c if self.engine == "c" else _step_mjx
        return advance(self, state, ctrl)

    def mujoco_model(self) -> Any:
        """Return the compiled `mujoco.MjModel` at this simulator's time step."""
        return load_model(self.model, self.timestep)


def import_mjx() -> Any:
    """Return the module `mujoco.mjx`; its report of a missing Warp stays off stdout, which may carry JSON."""
    with contextlib.redirect_stdout(io.StringIO()):
        if importlib.util.find_spec("warp"):
            warp = importlib.import_module("warp")
            warp.config.log_level = warp.LOG_WARNING
        return importlib.import_module("mujoco.mjx")


@functools.cache
def _mjx_model(simulator: Simulator) -> tuple[Any, Any]:
    mjx, host = import_mjx(), simulator.mujoco_model()
    implementation = "warp" if simulator.engine == "warp" else "jax"
    budget = {"naconmax": WARP_CONTACTS, "njmax": WARP_ROWS} if implementation == "warp" else {}
    with jax.ensure_compile_time_eval():
        model = mjx.put_model(host, impl=implementation)
        if implementation == "warp":
            model = model.tree_replace({"opt._impl.warn_overflow": 0})
        return model, mjx.make_data(host, impl=implementation, **budget)


def _step_mjx(simulator: Simulator, state: Integration, ctrl: jax.Array) -> tuple[Integration, jax.Array]:
    """MJX, its own JAX implementation or Warp's; the scan carries the integration state, so the rest of `Data` is dead."""
    mjx, (model, blank) = import_mjx(), _mjx_model(simulator)

    def substep(carry, _):
        data = blank.replace(ctrl=ctrl, **{field: getattr(carry[0], field) for field in FIELDS})
        data = mjx.step(model, data)
        after = Integration(*[getattr(data, field) for field in FIELDS])
        if simulator.engine == "warp":
            after = after.replace(qpos=jnp.where(_warp_overflowed(data), jnp.nan, after.qpos))
        return (after, data.sensordata), None

    with _guarded_kinematics(), jax.default_matmul_precision("highest"):
        return jax.lax.scan(substep, (state, blank.sensordata), length=simulator.substeps)[0]


def _warp_overflowed(data: Any) -> jax.Array:
    """Return whether contacts or rows of a Warp step did not fit: it drops them without a word."""
    return (data._impl.nacon > WARP_CONTACTS).any() | (data._impl.nefc > WARP_ROWS).any()


@contextlib.contextmanager
def _guarded_kinematics() -> Iterator[None]:
    """While tracing, keep XLA from fusing MJX's walk along a chain of bodies into itself.

    XLA:CPU of jax 0.10 recomputes every parent in each child, exponentially often (248 ms for what takes 0.4); a barrier on
    the carry stops it and costs nothing elsewhere.
    """
    scan: Any = importlib.import_module("mujoco.mjx._src.scan")
    body_tree = scan.body_tree

    def guarded(model, f, *rest, **options):
        return body_tree(model, lambda carry, *args: f(jax.lax.optimization_barrier(carry), *args), *rest, **options)

    scan.body_tree = guarded
    try:
        yield
    finally:
        scan.body_tree = body_tree


def _step_c(simulator: Simulator, state: Integration, ctrl: jax.Array) -> tuple[Integration, jax.Array]:
    """MuJoCo's C engine in float64 behind one callback, which takes and returns one row a lane."""
    order = ("time", "qpos", "qvel", "act", "qacc_warmstart")
    row = jnp.concatenate([jnp.ravel(getattr(state, field)) for field in (*order, "mocap_pos", "mocap_quat")] + [ctrl])
    widths = np.cumsum([getattr(state, field).size for field in order])
    out = jax.ShapeDtypeStruct((widths[-1] + simulator.mujoco_model().nsensordata,), jnp.float32)
    after = jax.pure_callback(_host(simulator), out, row, vmap_method="broadcast_all")
    time, *rest, sensors = jnp.split(after, widths)
    return state.replace(time=time[0], **dict(zip(order[1:], rest, strict=True))), sensors


class _Rollout:
    """The host's half of engine `c`: rows of integration state and control in, rows of state and sensors out.

    All rows go through one call of `mujoco.rollout`, on a pool of as many threads as this process may use cores, or half
    of them for few rows, where waking a thread costs more than it does.
    """

    def __init__(self, simulator: Simulator):
        mujoco: Any = importlib.import_module("mujoco")
        rollout: Any = importlib.import_module("mujoco.rollout")
        self.model, self.substeps = copy.copy(simulator.mujoco_model()), simulator.substeps
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        model, bits = self.model, mujoco.mjtState
        self.held = bits.mjSTATE_MOCAP_POS | bits.mjSTATE_MOCAP_QUAT | bits.mjSTATE_CTRL
        self.physics = 1 + model.nq + model.nv + model.na
        self.velocity = slice(1 + model.nq, 1 + model.nq + model.nv)
        self.mocap = slice(self.physics + model.nv, self.physics + model.nv + 7 * model.nmocap)
        self.cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        self.data = [mujoco.MjData(model) for _ in range(self.cores)]
        self.pools = {count: rollout.Rollout(nthread=count) for count in {self.cores, self._few}}
        self.lock = threading.Lock()

    @property
    def _few(self) -> int:
        return max(1, self.cores // 2)

    def __call__(self, rows: np.ndarray) -> np.ndarray:
        """Return rows [..., state, warmstart, sensors] one control step after rows [..., state, warmstart, mocap, ctrl]."""
        shape, rows = rows.shape[:-1], np.asarray(rows, np.float64).reshape(-1, rows.shape[-1])
        count, last = len(rows), self.substeps - 1
        states = np.empty((count, self.substeps, self.physics))
        sensors = np.empty((count, self.substeps, self.model.nsensordata))
        start, warmstart = map(np.ascontiguousarray, np.split(rows[:, : self.mocap.start], [self.physics], axis=1))
        held = np.repeat(np.hstack([rows[:, self.mocap.stop :], rows[:, self.mocap]])[:, None], self.substeps, axis=1)
        threads = self.cores if count > 4 * self.cores else self._few
        with self.lock:
            self.pools[threads].rollout(
                [self.model] * count, self.data[:threads], start, held, control_spec=self.held, skip_checks=True,
                nstep=self.substeps, initial_warmstart=warmstart, state=states, sensordata=sensors,
            )  # fmt: skip
        before = states[:, last - 1] if last else start
        acceleration = (states[:, last, self.velocity] - before[:, self.velocity]) / self.model.opt.timestep
        after = np.concatenate([states[:, last], acceleration, sensors[:, last]], axis=1, dtype=np.float32)
        return after.reshape(*shape, -1)


_host = functools.cache(_Rollout)


def mjx_data(name: str, state: Integration) -> Any:
    """Return the full `mjx.Data` of `state` in the model `name`, after forward kinematics."""
    mjx = import_mjx()
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
