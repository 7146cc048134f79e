"""The process of a worker, `python -m earl_jax.sweeps [FILE LINE]`: it reads a task of the launcher and prints what happens.

The task is one line of JSON. Without a file it comes from stdin, a pipe that the launcher holds open:
the worker ends with it.
"""

import gc
import json
import os
import sys
import threading
import warnings
from pathlib import Path
from typing import Any

from earl_jax.options import imports
from earl_jax.options.values import TimeLimit
from earl_jax.runs.files import format_warning
from earl_jax.runs.streams import lasting_streams
from earl_jax.sweeps.processes import cause_of, report


def main() -> int:
    """Do the task and return the exit code, 1 if a run failed."""
    if sys.argv[1:]:
        path, line = sys.argv[1:]
        task = json.loads(Path(path).read_text().splitlines()[int(line)])
    else:
        task = json.loads(sys.stdin.readline())
        end_with_pipe(sys.stdin.fileno())
    if task.get("cores") and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, task["cores"])  # before jax and the physics count the cores
    warnings.formatwarning = format_warning
    with lasting_streams():
        try:
            return int(serve(task) > 0)
        except KeyboardInterrupt as interrupt:  # a Stopped, which knows its exit code, or a signal before training
            print(str(interrupt) or "interrupted", file=sys.stderr)
            return getattr(interrupt, "exit_code", 130)


def serve(task: dict[str, Any]) -> int:
    """Plan the `grid` of `task`, or train its `runs`; report the plan or every event, and return the number of failures.

    Both have the folder `out`, and `imports`, the files that the process runs first, if they have not changed. A grid has
    `max_lanes` and the `logs` of its runs; runs can have the other arguments of `work` by name.
    """
    gc.set_threshold(100_000, 50, 50)  # as on the command line
    failed: list[str] = []

    def emit(name: str, state: str, detail: str) -> None:
        if state == "failed":
            failed.append(name)
        report(run=name, state=state, detail=detail)

    try:
        from earl_jax.runs.config import RunConfig  # jax, which takes seconds, is imported here
        from earl_jax.sweeps import worker

        for record in task.get("imports", ()):
            imports.note(**record)
        imports.run_noted()
        if "grid" in task:
            plan = worker.plan(Path(task["grid"]), Path(task["out"]), task["max_lanes"], task.get("logs", ()))
            report(state="planned", plan=plan)
            return 0
        configs = {name: RunConfig(**fields) for name, fields in task["runs"].items()}
    except Exception as error:
        cause = cause_of(error)
        if "grid" in task:
            report(state="refused", detail=cause)
        for name in task.get("runs", ()):
            emit(name, "failed", cause)
        return len(failed)
    options = {name: task[name] for name in ("progress", "devices", "logs") if name in task}
    limit = TimeLimit(*task["limit"]) if task.get("limit") else None
    worker.work(Path(task["out"]), configs, emit, limit=limit, **options)
    return len(failed)


def end_with_pipe(descriptor: int) -> None:
    """End this process as soon as the other end of the pipe `descriptor` closes, or anything is written to it.

    On Linux the system sends SIGIO, whose default action ends a process at once, even in code that holds Python's lock
    for long, such as that of a compiler. Elsewhere a thread waits.
    """
    if sys.platform == "linux":
        import fcntl

        fcntl.fcntl(descriptor, fcntl.F_SETOWN, os.getpid())
        fcntl.fcntl(descriptor, fcntl.F_SETFL, fcntl.fcntl(descriptor, fcntl.F_GETFL) | os.O_ASYNC)

    def wait() -> None:
        os.read(descriptor, 1)
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()  # also if it is closed already


if __name__ == "__main__":
    sys.exit(main())
