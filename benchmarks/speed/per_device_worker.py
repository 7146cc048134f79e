"""A program of benchmarks.per_device: it compiles, prints that it is ready, and trains for the seconds in each line of stdin.

Prints lines of JSON: `compile_s` when it is ready, then `steps_per_s` for each line of stdin, from the calls that ended in time.
"""

import argparse
import json
import os
import sys
import time


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("env")
    parser.add_argument("algo")
    parser.add_argument("--lanes", type=int, default=5)
    parser.add_argument("--chunk", type=int, default=1000)
    parser.add_argument("--set", nargs="*", default=[])
    parser.add_argument("--cores", type=int, nargs="+")
    arguments = parser.parse_args()
    if arguments.cores and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, arguments.cores)  # before jax and the physics count the cores
    advance, compile_s = _prepare(arguments)
    print(json.dumps({"compile_s": round(compile_s, 1)}), flush=True)
    for line in sys.stdin:
        print(json.dumps({"steps_per_s": _rate(advance, arguments.chunk, float(line))}), flush=True)


def _prepare(arguments: argparse.Namespace):
    """Return a function that trains for a chunk, and the seconds of its compilation; it has run once."""
    import jax

    from benchmarks.speed.training import compile_steps, make_training
    from earl_jax.cli.arguments import parse_options
    from earl_jax.training.program_cache import keep_programs

    keep_programs()
    options = parse_options(tuple(arguments.set))
    problem, method, state = make_training(arguments.env, arguments.algo, arguments.lanes, 100_000, **options)
    program, compile_s = compile_steps(problem, method, state, arguments.chunk)

    def advance() -> None:
        nonlocal state
        state = program(method, state)
        jax.block_until_ready(state.step)

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
    main()
