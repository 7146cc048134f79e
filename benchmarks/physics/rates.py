"""Measure control steps per second of every engine, without compile time.

    python -m benchmarks.physics.rates --lanes 1 100 1000 --engines c mjx warp --out benchmarks/results/physics/h200

Actions are random. A control step is that of the task, with observation and reward.
"""

import argparse
import os
import statistics
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

from benchmarks.output import save
from earl_jax.envs import list_envs, make
from earl_jax.physics.engine_choice import ENGINES
from earl_jax.report.tables import write

ENVS = [name for name in list_envs() if make(name).engine != "kinematic"]
MIN_SECONDS = 1.0
"""The shortest time of a timed repeat."""


def make_task(name: str, engine: str, substeps: int | None) -> Any:
    """Return the task `name` on `engine`, with its own `substeps` if they are None."""
    return make(name, engine=engine, **({"substeps": substeps} if substeps else {}))


def measure(name: str, engine: str, lanes: int, substeps: int | None, repeats: int) -> dict[str, Any]:
    """Return compile seconds and the median rate of one env, engine and number of lanes."""
    env = make_task(name, engine, substeps)
    state = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(0), lanes))

    def run(state, key, steps):
        def step(state, key):
            action = jax.random.uniform(key, (lanes, env.action_size), minval=-1.0, maxval=1.0)
            return jax.vmap(env.step)(state, action), None

        return jax.lax.scan(step, state, jax.random.split(key, steps))[0]

    began = time.perf_counter()
    steps = 10
    program = jax.jit(run, static_argnums=2, donate_argnums=0)
    state = jax.block_until_ready(program(state, jax.random.key(1), steps))
    compiled = time.perf_counter() - began
    began = time.perf_counter()
    state = jax.block_until_ready(program(state, jax.random.key(2), steps))
    first_rate = steps / (time.perf_counter() - began)
    steps = max(10, int(first_rate * MIN_SECONDS))
    state = jax.block_until_ready(program(state, jax.random.key(3), steps))
    rates = []
    for repeat in range(repeats):
        began = time.perf_counter()
        state = jax.block_until_ready(program(state, jax.random.key(4 + repeat), steps))
        rates.append(steps / (time.perf_counter() - began))
    rate = statistics.median(rates)
    return {
        "env": name, "engine": engine, "substeps": env.substeps, "lanes": lanes, "compile_s": round(compiled, 2),
        "ms_per_step": round(1e3 / rate, 4), "lane_steps_per_s": round(rate * lanes, 1),
        "finite": bool(jnp.isfinite(state.obs).all()),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--envs", nargs="+", default=list(ENVS), choices=ENVS)
    parser.add_argument("--engines", nargs="+", default=["c", "mjx"], choices=ENGINES)
    parser.add_argument("--lanes", type=int, nargs="+", default=[1, 100, 1000])
    parser.add_argument("--substeps", type=int, nargs="+", default=[None], help="other than each task's own")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/physics/run"))
    arguments = parser.parse_args()
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    rows = []
    for name in arguments.envs:
        settings = [
            (engine, lanes, substeps)
            for engine in arguments.engines
            for lanes in arguments.lanes
            for substeps in arguments.substeps
        ]
        for setting in settings:
            rows.append(measure(name, *setting, arguments.repeats))
            print(rows[-1], flush=True)
            save_rows(rows, arguments)


def save_rows(rows: list[dict[str, Any]], arguments: argparse.Namespace) -> None:
    """Write the rows so far as csv, and as json with the command, cores and versions."""
    options = {field: getattr(arguments, field) for field in ("envs", "engines", "lanes", "substeps")}
    given = {field: values for field, values in options.items() if values != [None]}
    text = " ".join(f"--{name} {' '.join(map(str, values))}" for name, values in given.items())
    command = f"python -m benchmarks.physics.rates {text}"
    write(rows, arguments.out.with_suffix(".csv"))
    save(arguments.out.with_suffix(".json"), command, {"cores": len(os.sched_getaffinity(0)), "rows": rows})


if __name__ == "__main__":
    main()
