"""The process of a worker of sweeps.

`python -m earl_jax.sweeps plan GRID --out DIR` prints a plan as JSON. `python -m earl_jax.sweeps work` reads the configs of
runs as one line of JSON from stdin, and prints events as lines of JSON. With `--end-with-stdin`, it ends when stdin, a pipe
from the launcher, closes.
"""

import argparse
import os
import sys
import threading
from pathlib import Path


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


def end_with_pipe(descriptor: int) -> None:
    """End this process as soon as the other end of the pipe `descriptor` closes, or anything is written to it.

    On Linux the system sends SIGIO, whose default action ends a process at once, even in code that holds Python's lock
    for long, such as that of a compiler. Elsewhere a thread waits.
    """
    if sys.platform == "linux":
        import fcntl

        fcntl.fcntl(descriptor, fcntl.F_SETOWN, os.getpid())
        fcntl.fcntl(descriptor, fcntl.F_SETFL, fcntl.fcntl(descriptor, fcntl.F_GETFL) | os.O_ASYNC)
    threading.Thread(target=_exit_when_closed, args=(descriptor,), daemon=True).start()  # also if it is closed already


def _exit_when_closed(descriptor: int) -> None:
    while os.read(descriptor, 1):
        pass
    os._exit(1)


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
