"""The process of a worker of sweeps.

`python -m earl_jax.sweeps plan GRID --out DIR` prints a plan as JSON. `python -m earl_jax.sweeps work` reads the configs of
runs as one line of JSON from stdin, and prints events as lines of JSON. With `--end-with-stdin`, it ends when stdin, a pipe
from the launcher, closes.
"""

import argparse
import os
import sys
from pathlib import Path

from earl_jax.sweeps.parent import end_with_pipe


def main(arguments: list[str] | None = None) -> int:
    """Run one of the worker's two commands and return the exit code: 2 with a one-line error for invalid input."""
    options = _parser().parse_args(arguments)
    task = sys.stdin.readline() if options.command == "work" else ""
    if options.end_with_stdin:
        end_with_pipe(sys.stdin.fileno())
    if options.command == "work" and options.cores and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, options.cores)  # before jax and the physics count the cores
    from earl_jax.sweeps import worker  # it imports jax, which takes seconds

    try:
        if options.command == "work":
            return worker.serve(task)
    except KeyboardInterrupt as interrupt:  # a Stopped, which knows its exit code, or Ctrl-C before training
        print(str(interrupt) or "interrupted", file=sys.stderr)
        return getattr(interrupt, "exit_code", 130)
    return worker.print_plan(options.grid, options.out, options.max_lanes)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m earl_jax.sweeps", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    planning = commands.add_parser("plan")
    planning.add_argument("grid", type=Path)
    planning.add_argument("--out", type=Path, required=True)
    planning.add_argument("--max-lanes", type=int)
    working = commands.add_parser("work")
    working.add_argument("--cores", type=int, nargs="+", help="the only cores that the worker may use")
    for command in (planning, working):
        command.add_argument("--end-with-stdin", action="store_true")
    return parser


if __name__ == "__main__":
    sys.exit(main())
