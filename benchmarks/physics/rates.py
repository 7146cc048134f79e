"""Measure control steps per second of every engine, without compile time.

    python -m benchmarks.physics.rates --lanes 1 100 1000 --engines c mjx warp --out benchmarks/results/physics/h200

Actions are random. A control step is that of the task, with observation and reward.
"""

import itertools
import statistics
import time
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import tyro

from benchmarks.output import RESULTS, save_rows
from earl_jax.envs import chosen_engine, list_envs, make
from earl_jax.options.environment import own_cores

ENVS = tuple(name for name in list_envs() if chosen_engine(make(name)) != "kinematic")
MIN_SECONDS = 1.0
"""The shortest time of a timed repeat."""


def measure(name: str, engine: str, lanes: int, substeps: int | None, repeats: int) -> dict[str, Any]:
    """Return compile seconds and the median rate of one env, engine and number of lanes."""
    env = make(name, engine=engine, **({"substeps": substeps} if substeps else {}))
    state = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(0), lanes))

    def run(state, key, steps):
        def step(state, key):
            action = jax.random.uniform(key, (lanes, env.action_size), minval=-1.0, maxval=1.0)
            return jax.vmap(env.step)(state, action), None

        return jax.lax.scan(step, state, jax.random.split(key, steps))[0]

    program = jax.jit(run, static_argnums=2, donate_argnums=0)

    def seconds(steps):
        nonlocal state
        began = time.perf_counter()
        state = jax.block_until_ready(program(state, jax.random.key(1), steps))
        return time.perf_counter() - began

    compiled = seconds(10)
    steps = max(10, int(10 / seconds(10) * MIN_SECONDS))
    seconds(steps)
    rate = statistics.median(steps / seconds(steps) for _ in range(repeats))
    return {
        "env": name, "engine": engine, "substeps": env.substeps, "lanes": lanes, "compile_s": round(compiled, 2),
        "ms_per_step": round(1e3 / rate, 4), "lane_steps_per_s": round(rate * lanes, 1),
        "finite": bool(jnp.isfinite(state.obs).all()),
    }  # fmt: skip


def main(
    envs: tuple[str, ...] = ENVS,
    engines: tuple[Literal["c", "mjx", "warp"], ...] = ("c", "mjx"),
    lanes: tuple[int, ...] = (1, 100, 1000),
    substeps: tuple[int, ...] = (),
    repeats: int = 3,
    out: Path = RESULTS / "physics" / "run",
) -> None:
    """Measure each task on each engine; `substeps` are by default each task's own."""
    rows = []
    for setting in itertools.product(envs, engines, lanes, substeps or (None,)):
        rows.append(measure(*setting, repeats))
        print(rows[-1], flush=True)
        save_rows(out, rows, cores=len(own_cores()))


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
