"""The processes of workers: how they start, what they report, and the signals that reach all of them."""

import contextlib
import json
import os
import queue
import signal
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Iterator, Sequence
from typing import Any

from earl_jax.errors import InputError, is_input_error
from earl_jax.options.environment import PYTHON, module_path, start_failure
from earl_jax.sweeps.slots import Slot

WORKER = [*PYTHON, "-m", "earl_jax.sweeps"]
ENDS = ("done", "failed", "stopped")
"""States in which a worker leaves a run; it is stopped by the time limit."""
PATIENCE = 10
"""Seconds from SIGTERM to SIGKILL. Under MPS, SIGKILL of one program can end all others on its GPU."""
Task = dict[str, Any]
"""What a worker reads: a `grid` to plan, or the configs of `runs` to train, as `__main__.serve` takes them."""
Event = dict[str, Any]
"""What a worker prints: the `state` of a `run` with a `detail`, the step or why it failed; or the `plan` of a grid."""
MARK = "\x1e"
"""Begins an event, as in RFC 7464, because other output can stand before it on the line."""


def report(**event: Any) -> None:
    """Print `event`, in the process of a worker, in one write, between whose parts no other thread can print."""
    print(f"{MARK}{json.dumps(event)}\n", end="", flush=True)


def cause_of(error: Exception) -> str:
    """Return `error` as one line, after printing its traceback if it is more than invalid input or settings of jax."""
    if isinstance(error, InputError):
        return str(error)
    if not is_input_error(error):
        if cause := start_failure(error):
            return cause
        traceback.print_exception(error)
    return f"{type(error).__name__}: {error}".splitlines()[0]


def start(task: Task, slot: Slot) -> subprocess.Popen[str]:
    """Return a worker at `slot` that has received `task`. It ends when this process ends, for whatever reason.

    A terminal's Ctrl-C does not reach it, because it has a session of its own.
    """
    worker = subprocess.Popen(
        WORKER,
        env=slot.environment(os.environ) | {"PYTHONPATH": module_path()},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        errors="replace",
        start_new_session=True,
    )
    assert worker.stdin is not None
    with contextlib.suppress(BrokenPipeError):  # a worker that has ended already sends no events
        os.write(worker.stdin.fileno(), (json.dumps({**task, "cores": slot.cores}) + "\n").encode())
    return worker


def events(worker: subprocess.Popen[str]) -> Iterator[Event]:
    """Yield the events of `worker` until it ends; its other output goes to stderr."""
    assert worker.stdout is not None
    for line in worker.stdout:
        output, mark, event = line.partition(MARK)
        sys.stderr.write(output)  # as a whole, because other workers write too
        if mark and event.endswith("\n"):  # a kill can cut the last one
            yield json.loads(event)


class Workers:
    """The workers of a sweep. As a context it passes SIGINT, SIGTERM and SIGHUP on to all of them, which save and end.

    A signal that is ignored, as by `nohup`, stays so. A second signal ends the launcher. Workers that still run when the
    context ends are ended too.
    """

    def __init__(self):
        self.signal: int | None = None
        self._lock = threading.RLock()
        self._started: list[subprocess.Popen[str]] = []
        self._handlers: dict[int, Any] = {}

    def __enter__(self) -> "Workers":
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
                if signal.getsignal(number) != signal.SIG_IGN:
                    self._handlers[number] = signal.signal(number, self._stop)
        return self

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        with self._lock:
            self.signal = self.signal or (signal.SIGTERM if kind else None)
            running = [worker for worker in self._started if worker.poll() is None]
        for worker in running:
            worker.terminate()
        deadline = time.monotonic() + PATIENCE
        for worker in running:
            with contextlib.suppress(subprocess.TimeoutExpired):
                worker.wait(max(0, deadline - time.monotonic()))
            worker.kill()
            worker.wait()
        for number, handler in self._handlers.items():
            signal.signal(number, handler)
        if kind is SystemExit:
            print("earl-jax: ended by a second signal; repeat the command to continue", file=sys.stderr)

    def _stop(self, number: int, frame: object) -> None:
        with self._lock:
            if self.signal is not None:
                raise SystemExit(128 + number)
            self.signal = number
            for worker in self._started:
                worker.send_signal(number)

    def run(self, task: Task, slot: Slot) -> Iterator[Event]:
        """Yield the events of a worker that trains the runs of `task`. A run that it does not finish ends with a failed event.

        After a signal, or if the time limit of the task has passed, there is no worker and no event.
        """
        if self.signal or (task.get("limit") and task["limit"].passed):
            return
        unfinished = set(task["runs"])
        with start(task, slot) as worker:
            with self._lock:
                self._started.append(worker)
                if self.signal is not None:
                    worker.send_signal(self.signal)
            for event in events(worker):
                if event["state"] in ENDS:
                    unfinished.discard(event["run"])
                yield event
        code = worker.returncode
        detail = f"the worker was ended by signal {-code}" if code < 0 else f"the worker ended with code {code}"
        for name in sorted(unfinished):
            yield {"run": name, "state": "failed", "detail": detail}

    def run_all(self, tasks: Sequence[Task], slots: Sequence[Slot]) -> Iterator[Event]:
        """Yield the events of `tasks` in the caller's thread as they arrive, with one worker at a time at each of `slots`."""
        waiting: queue.SimpleQueue[Task | None] = queue.SimpleQueue()
        for task in [*tasks, *[None] * len(slots)]:
            waiting.put(task)
        arrived: queue.SimpleQueue[Event | Exception | None] = queue.SimpleQueue()

        def serve(slot: Slot) -> None:
            try:
                for task in iter(waiting.get, None):
                    for event in self.run(task, slot):
                        arrived.put(event)
            except Exception as error:
                arrived.put(error)
            arrived.put(None)

        for slot in slots:
            threading.Thread(target=serve, args=(slot,), daemon=True).start()
        for _ in slots:
            for event in iter(arrived.get, None):
                if isinstance(event, Exception):
                    raise event
                yield event
