"""Measure training steps per second, without compile time: `python -m benchmarks.speed.training --env sawyer_door --lanes 1 10`.

Writes OUT.json and OUT.csv. A lane-step is one control step and one gradient step of one seed.
"""

import itertools
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import tyro

from benchmarks.output import RESULTS, save_rows
from benchmarks.speed.peers.common import median_s
from earl_jax.algos import Method, make_algo
from earl_jax.envs import chosen_engine, make
from earl_jax.physics import resolve_engine
from earl_jax.protocol import Protocol
from earl_jax.training.init import init_train_state
from earl_jax.training.plan import per_lane
from earl_jax.training.scan import run_steps
from earl_jax.training.state import Problem, TrainState, seed_keys


def make_training(name: str, algo: str, lanes: int, steps: int, **options: Any) -> tuple[Problem, Method, TrainState]:
    """Return a problem, its method and the train state at step 0 with a replay for `steps` steps."""
    env = make(name)
    problem = Problem(env, Protocol(env.train_horizon, env.eval_horizon))
    method = per_lane(make_algo(algo, **options), lanes)
    init = jax.jit(lambda m, keys: init_train_state(problem, m, keys, steps))
    return problem, method, init(method, seed_keys(range(lanes)))


def compile_steps(
    problem: Problem, method: Method, state: list[TrainState], steps: int, warmup: bool = False
) -> tuple[Callable[[], None], Any, float]:
    """Return a function that trains for `steps` steps, its program, and the seconds of its compilation.

    The function replaces the only item of `state`, which programs of other lengths can share.
    """
    began = time.perf_counter()
    jitted = jax.jit(lambda m, state: run_steps(problem, m, state, steps, warmup), donate_argnums=1)
    program = jitted.lower(method, state[0]).compile()
    seconds = time.perf_counter() - began

    def advance() -> None:
        state[0] = program(method, state[0])
        jax.block_until_ready(state[0].step)

    return advance, program, seconds


def measure(name: str, algo: str, lanes: int, steps: int, repeats: int) -> dict:
    """Return compile seconds and the median steps per second of `algo` on task `name` with `lanes` lanes."""
    problem, method, state = make_training(name, algo, lanes, 100_000)
    advance, program, compiled = compile_steps(problem, method, [state], steps)
    advance()
    rate = steps / median_s(advance, repeats)
    return {
        "env": name, "engine": resolve_engine(chosen_engine(problem.env)), "algo": algo, "lanes": lanes,
        "compile_s": round(compiled, 2), "steps_per_s": round(rate, 1),
        "lane_steps_per_s": round(rate * lanes, 1), "temporary_mb": program.memory_analysis().temp_size_in_bytes / 1e6,
    }  # fmt: skip


def main(
    env: str = "tabletop_organization",
    lanes: tuple[int, ...] = (1, 4),
    algos: tuple[str, ...] = ("naive",),
    steps: int = 1000,
    repeats: int = 3,
    out: Path = RESULTS / "speed" / "run",
) -> None:
    """Measure each method with each number of lanes."""
    rows = []
    for algo, count in itertools.product(algos, lanes):
        rows.append(measure(env, algo, count, steps, repeats))
        print(rows[-1], flush=True)
    save_rows(out, rows)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
