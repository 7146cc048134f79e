"""A program of benchmarks.speed.per_device: it compiles, says so, and trains for the seconds in each line of stdin.

Prints lines of JSON: `compile_s` when it is ready, then `steps_per_s` for each line of stdin, from the calls that ended in time.
"""

import json
import os
import sys
import time

import tyro
from tyro.conf import Positional


def main(
    env: Positional[str],
    algo: Positional[str],
    cores: tuple[int, ...],
    lanes: int = 5,
    chunk: int = 1000,
    set: tuple[str, ...] = (),
) -> None:
    """Compile the program of a method on a task, and train on request."""
    if cores and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, cores)  # before jax and the physics count the cores
    advance, compile_s = _prepare(env, algo, lanes, chunk, set)
    print(json.dumps({"compile_s": round(compile_s, 1)}), flush=True)
    for line in sys.stdin:
        print(json.dumps({"steps_per_s": _rate(advance, chunk, float(line))}), flush=True)


def _prepare(env: str, algo: str, lanes: int, chunk: int, options: tuple[str, ...]):
    """Return a function that trains for a chunk, and the seconds of its compilation; it has run once."""
    from benchmarks.speed.training import compile_steps, make_training
    from earl_jax.cli.arguments import parse_options
    from earl_jax.training.program_cache import use_program_cache

    use_program_cache()
    problem, method, state = make_training(env, algo, lanes, 100_000, **parse_options(options))
    advance, _, compile_s = compile_steps(problem, method, [state], chunk)
    advance()
    return advance, compile_s


def _rate(advance, chunk: int, seconds: float) -> float:
    """Return the steps per second of the chunks that end within `seconds`; at least one."""
    began, ends = time.perf_counter(), []
    while not ends or ends[-1] < seconds:
        advance()
        ends.append(time.perf_counter() - began)
    counted = [end for end in ends if end <= seconds] or ends[:1]
    return len(counted) * chunk / counted[-1]


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
