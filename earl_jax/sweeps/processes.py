"""The processes of workers: what they report, one at a time at each slot, and the signals that reach all of them."""

import contextlib
import json
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from earl_jax.sweeps.slots import Slot

WORKER = [sys.executable, "-m", "earl_jax.sweeps"]
TIED = "--end-with-stdin"
"""The worker's option to end as soon as its launcher does: stdin is a pipe that the launcher holds open."""
ENDS = ("done", "failed", "stopped")
"""States in which a worker leaves a run; it is stopped by the time limit."""
PATIENCE = 10
"""Seconds from SIGTERM to SIGKILL. Under MPS, SIGKILL of one program can end all others on its GPU."""
Task = dict[str, Any]
Event = dict[str, Any]


class Workers:
    """The running workers of a sweep, a context in which SIGINT and SIGTERM reach all of them: they save and end.

    A second signal ends the launcher. Workers that still run when the context ends are ended too. They have sessions of their
    own, so that a terminal sends Ctrl-C to the launcher alone.
    """

    def __init__(self):
        self.signal: int | None = None
        self._lock = threading.RLock()
        self._running: list[subprocess.Popen[str]] = []
        self._ended = False
        self._handlers: dict[int, Any] = {}

    def __enter__(self) -> "Workers":
        if threading.current_thread() is threading.main_thread():
            self._handlers = {number: signal.signal(number, self._stop) for number in (signal.SIGINT, signal.SIGTERM)}
        return self

    def __exit__(self, *error: object) -> None:
        with self._lock:
            self._ended, running = True, list(self._running)
        for worker in running:
            worker.terminate()
        deadline = time.monotonic() + PATIENCE
        for worker in running:
            try:
                worker.wait(max(0, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                worker.kill()
                worker.wait()
        for number, handler in self._handlers.items():
            signal.signal(number, handler)

    def _stop(self, number: int, frame: object) -> None:
        with self._lock:
            if self.signal is not None:
                raise SystemExit(128 + number)
            self.signal = number
            for worker in self._running:
                worker.send_signal(number)

    def add(self, worker: subprocess.Popen[str]) -> None:
        """Let `worker` receive the signal, once, also if it has arrived already."""
        with self._lock:
            self._running = [other for other in self._running if other.poll() is None] + [worker]
            number = signal.SIGTERM if self._ended else self.signal
            if number is not None:
                worker.send_signal(number)


def worker_events(task: Task, workers: Workers | None = None, slot: Slot | None = None) -> Iterator[Event]:
    """Yield the events of a worker that trains the runs of `task`. A run that it does not finish ends with a failed event.

    The worker ends when this process ends, for whatever reason. If the time limit of the task has passed, there is no worker
    and no event.
    """
    if task.get("limit") and task["limit"].passed:
        return
    worker = subprocess.Popen(
        [*WORKER, "work", TIED, *(slot.arguments if slot else ())],
        env=slot.environment(os.environ) if slot else None,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        errors="replace",
        start_new_session=workers is not None,
    )
    if workers is not None:
        workers.add(worker)
    assert worker.stdin is not None
    assert worker.stdout is not None
    unfinished = set(task["runs"])
    with worker:
        with contextlib.suppress(BrokenPipeError):  # a worker that has ended already sends no events
            os.write(worker.stdin.fileno(), (json.dumps(task) + "\n").encode())
        for line in worker.stdout:
            event = _parse_event(line)
            if event is None:
                sys.stderr.write(line)  # as a whole, because other workers write too
                continue
            if event["state"] in ENDS:
                unfinished.discard(event["run"])
            yield event
    code = worker.returncode
    why = f"the worker was ended by signal {-code}" if code < 0 else f"the worker ended with code {code}"
    for name in sorted(unfinished):
        yield {"run": name, "state": "failed", "why": why}


def _parse_event(line: str) -> Event | None:
    """Return the event in a line of a worker's output, or None for any other line."""
    try:
        event = json.loads(line)
    except json.JSONDecodeError:
        return None
    return event if isinstance(event, dict) and "run" in event else None


def concurrent_events(
    tasks: Sequence[Task],
    slots: Sequence[Slot | None],
    workers: Workers,
    events_of: Callable[[Task, Workers, Slot | None], Iterator[Event]],
) -> Iterator[Event]:
    """Yield the events of `tasks` as they arrive, with one worker at a time at each of `slots`; `events_of` is worker_events.

    A task starts when a slot becomes free, and none starts after a signal. The caller reads all events in one thread, so that
    it can print lines.
    """
    waiting: queue.SimpleQueue[Task] = queue.SimpleQueue()
    for task in tasks:
        waiting.put(task)
    events: queue.SimpleQueue[Event | BaseException] = queue.SimpleQueue()

    def serve(slot: Slot | None) -> None:
        try:
            while workers.signal is None:
                for event in events_of(waiting.get_nowait(), workers, slot):
                    events.put(event)
            raise queue.Empty  # it marks the end of a slot's events
        except BaseException as error:
            events.put(error)

    for slot in slots:
        threading.Thread(target=serve, args=(slot,), daemon=True).start()
    busy = len(slots)
    while busy:
        event = events.get()
        if isinstance(event, queue.Empty):
            busy -= 1
        elif isinstance(event, BaseException):
            raise event
        else:
            yield event
