"""The process of a worker, `python -m earl_jax.sweeps [FILE LINE]`: it reads a task of the launcher and prints what happens.

The task is one line of JSON. Without a file it comes from stdin, a pipe that the launcher holds open:
the worker ends with it.
"""

import json
import os
import sys
import threading
import warnings
from pathlib import Path

from earl_jax.options.environment import start_failure
from earl_jax.runs.files import format_warning
from earl_jax.runs.streams import lasting_streams
from earl_jax.sweeps.processes import report


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
            from earl_jax.sweeps import worker  # it imports jax, which takes seconds

            return int(worker.serve(task) > 0)
        except KeyboardInterrupt as interrupt:  # a Stopped, which knows its exit code, or a signal before training
            print(str(interrupt) or "interrupted", file=sys.stderr)
            return getattr(interrupt, "exit_code", 130)
        except Exception as error:
            if not (cause := start_failure(error)):
                raise
            report(state="refused", detail=cause)
            return 2


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
