"""Time the host's control step of engine `c` in several arrangements: `python -m benchmarks.host_step minitaur_pen --lanes 1 5`.

All variants simulate the same rows in turn, in one process; a pause before each call lets the threads fall asleep, as they do
while a GPU acts. `ratio` is the median of the ratios to the first variant. The variants:

- `rollout`: the former arrangement, `mujoco.rollout`, with an actuator one call for each substep and NumPy between.
- `batch`: as shipped. `batch, N threads`: the same with another number of threads.
- `batch, unbound`: as shipped, but the actuator's general form in place of the bound one.
- `batch, held`: one call with constant controls, a lower bound for any actuator inside MuJoCo. Its result differs.
"""

import argparse
import copy
import importlib
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from benchmarks.output import save
from benchmarks.physics import ENVS
from earl_jax.envs import make
from earl_jax.machine import own_cores
from earl_jax.physics.engines import c
from earl_jax.physics.engines.simulations import Simulations, UnboundActuator
from earl_jax.report.tables import write

WARM_STEPS = 50
Advance = Callable[[np.ndarray], np.ndarray]


class Rollouts:
    """The former arrangement: `mujoco.rollout` on a pool of threads."""

    def __init__(self, host: c.Host, count: int, threads: int):
        rollout: Any = importlib.import_module("mujoco.rollout")
        bits, model = mujoco.mjtState, host.model
        self.host, self.model, self.simulator = host, model, host.simulator
        self.spec = bits.mjSTATE_MOCAP_POS | bits.mjSTATE_MOCAP_QUAT | bits.mjSTATE_CTRL
        self.physics = 1 + model.nq + model.nv + model.na
        self.widths = np.cumsum(
            [self.physics, model.nv, host.memory, 7 * model.nmocap, self.simulator.variation_size]
        ).tolist()
        self.pool = rollout.Rollout(nthread=threads)
        self.data = [mujoco.MjData(model) for _ in range(threads)]
        self.models = [copy.copy(model) if self.simulator.varied else model for _ in range(count)]

    def advance(self, rows: np.ndarray) -> np.ndarray:
        split = np.split(rows.astype(np.float64), self.widths, axis=1)
        state, warmstart, memory, mocap, constants, command = split
        if self.simulator.varied:
            self._write_constants(constants)
        simulator, position, speed = self.simulator, 1 + self.model.nq, 1 + self.model.nq + self.model.nv
        if simulator.actuator is None:
            state, warmstart, sensors = self._roll(state, warmstart, mocap, command, simulator.substeps)
        for _ in range(simulator.substeps if simulator.actuator else 0):
            joints, speeds = state[:, 1:position], state[:, position:speed]
            ctrl, memory = simulator.controls(np, joints, speeds, command, memory)
            state, warmstart, sensors = self._roll(state, warmstart, mocap, ctrl, 1)
        return np.concatenate([state, warmstart, memory, sensors], axis=1, dtype=np.float32)

    def _write_constants(self, constants: np.ndarray) -> None:
        """Compare the constants as the former arrangement did, and write them at the first call."""
        if np.array_equal(getattr(self, "constants", None), constants):
            return
        self.constants = constants
        for model, row in zip(self.models, constants, strict=True):
            for field, value in self.simulator.variation(row).items():
                getattr(model, field)[:] = value

    def _roll(self, state, warmstart, mocap, ctrl, steps: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        count, last = len(state), steps - 1
        states = np.empty((count, steps, self.physics))
        sensors = np.empty((count, steps, self.model.nsensordata))
        held = np.repeat(np.concatenate([ctrl, mocap], axis=1)[:, None], steps, axis=1)
        start = np.ascontiguousarray(state)
        self.pool.rollout(
            self.models, self.data, start, held, control_spec=self.spec, skip_checks=True, nstep=steps,
            initial_warmstart=np.ascontiguousarray(warmstart), state=states, sensordata=sensors,
        )  # fmt: skip
        before, speeds = (
            states[:, last - 1] if last else start,
            slice(1 + self.model.nq, 1 + self.model.nq + self.model.nv),
        )
        return (
            states[:, last],
            (states[:, last, speeds] - before[:, speeds]) / self.model.opt.timestep,
            sensors[:, last],
        )


def held(simulations: Simulations) -> Advance:
    """Return a control step with one call and constant controls."""

    def advance(rows: np.ndarray) -> np.ndarray:
        for part, columns in simulations.inputs:
            part[:] = rows[:, columns]
        memory = rows[:, simulations.memory]
        simulations.batch.step(nstep=simulations.substeps)
        parts = [*simulations.outputs, simulations.warmstart, memory, simulations.sensors]
        return np.concatenate(parts, axis=1, dtype=np.float32)

    return advance


def unbound(simulations: Simulations, simulator: Any) -> Advance:
    """Return the control step of `simulations` with the general form of the actuator."""
    joints = simulations.qpos, simulations.qvel, simulations.ctrl
    simulations.actuator = UnboundActuator(simulator.actuator, *joints)
    return simulations.advance


def former_threads(rows: int, threads: int, actuated: bool) -> int:
    """Return the number of threads of the former arrangement."""
    load = rows / threads / (4 if actuated else 1)
    return max(1, threads // 2 if load <= 1 else threads * 3 // 4 if load <= 4 else threads)


def variants(host: c.Host, rows: np.ndarray) -> dict[str, Advance]:
    """Return the arrangements for these `rows`, after one call of each."""
    count, cores, simulator = len(rows), len(own_cores()), host.simulator
    chosen = c.WorkerPool(host, cores)._threads(count)
    steps = {
        "rollout": Rollouts(host, count, former_threads(count, cores, bool(simulator.actuator))).advance,
        "batch": host.simulations(count, chosen).advance,
    }
    for threads in sorted({1, 2, 3, cores // 4, cores // 2, cores * 3 // 4, cores} - {chosen, 0}):
        if threads <= min(count, cores):
            steps[f"batch, {threads} threads"] = host.simulations(count, threads).advance
    if simulator.actuator:
        steps["batch, unbound"] = unbound(host.simulations(count, chosen), simulator)
        steps["batch, held"] = held(host.simulations(count, chosen))
    return steps


def rows_of(env: Any, lanes: int) -> np.ndarray:
    """Return the host's input rows of robots in the middle of random movements."""
    state = jax.vmap(env.reset)(jax.random.split(jax.random.key(0), lanes))
    actions = jax.random.uniform(jax.random.key(1), (WARM_STEPS, lanes, env.action_size), minval=-1.0, maxval=1.0)
    state = jax.jit(lambda s: jax.lax.scan(lambda s, a: (jax.vmap(env.step)(s, a), None), s, actions)[0])(state)
    data, command = jax.vmap(env.control)(state, actions[0])
    fields = [jnp.reshape(getattr(data, field), (lanes, -1)) for field in c.CHANGED + c.CONSTANT]
    return np.asarray(jnp.concatenate([*fields, command], axis=1))


def alternate(steps: dict[str, Advance], rows: np.ndarray, repeats: int, pause: float) -> dict[str, list[float]]:
    """Return seconds of every call, one variant after the other in every repeat, after five untimed ones."""
    times: dict[str, list[float]] = {name: [] for name in steps}
    for _ in range(repeats + 5):
        for name, step in steps.items():
            until = time.perf_counter() + pause
            while time.perf_counter() < until:
                pass
            began = time.perf_counter()
            step(rows)
            times[name].append(time.perf_counter() - began)
    return {name: seconds[5:] for name, seconds in times.items()}


def measure(name: str, lanes: int, repeats: int, pause: float) -> list[dict[str, Any]]:
    """Return a row of the table for each variant of one task and number of lanes."""
    env = make(name, engine="c")
    rows = rows_of(env, lanes)
    host = c.host_of(env.simulator, env.reset(jax.random.key(0)).data.memory.size)
    steps = variants(host, rows)
    expected = steps["rollout"](rows)
    times = alternate(steps, rows, repeats, pause)
    first = np.array(times["rollout"])
    return [
        {
            "env": name, "lanes": lanes, "cores": len(own_cores()), "variant": variant,
            "ms": round(1e3 * statistics.median(seconds), 4), "fastest_ms": round(1e3 * min(seconds), 4),
            "ratio": round(float(np.median(np.array(seconds) / first)), 3),
            "largest_difference": float(np.abs(steps[variant](rows) - expected).max()),
        }
        for variant, seconds in times.items()
    ]  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("envs", nargs="+", choices=ENVS)
    parser.add_argument("--lanes", type=int, nargs="+", default=[1, 5, 10, 25])
    parser.add_argument("--repeats", type=int, default=300)
    parser.add_argument("--pause-us", type=float, default=200.0)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/physics/host_step"))
    arguments = parser.parse_args()
    table: list[dict[str, Any]] = []
    for name in arguments.envs:
        for lanes in arguments.lanes:
            part = measure(name, lanes, arguments.repeats, 1e-6 * arguments.pause_us)
            table += part
            for row in part:
                print(*row.values(), sep="\t", flush=True)
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    write(table, arguments.out.with_suffix(".csv"))
    lanes = " ".join(map(str, arguments.lanes))
    command = f"python -m benchmarks.host_step {' '.join(arguments.envs)} --lanes {lanes}"
    save(arguments.out.with_suffix(".json"), f"{command} --pause-us {arguments.pause_us:g}", {"rows": table})


if __name__ == "__main__":
    main()
