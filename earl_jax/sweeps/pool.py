"""Workers that run at the same time, one at each slot, and the signals that reach all of them."""

import contextlib
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import IO, Any, TypeVar

Task = dict[str, Any]
Event = dict[str, Any]
SlotT = TypeVar("SlotT")


class ForwardedSignal:
    """A context in which SIGINT and SIGTERM stop a sweep: workers save their state and end. A second signal ends all.

    Workers have sessions of their own, so that a terminal sends Ctrl-C to the launcher alone.
    """

    def __init__(self):
        self.signal: int | None = None
        self._lock = threading.RLock()
        self._running: list[subprocess.Popen[str]] = []
        self._ended = False
        self._earlier: dict[int, Any] = {}

    def __enter__(self) -> "ForwardedSignal":
        if threading.current_thread() is threading.main_thread():
            self._earlier = {number: signal.signal(number, self._stop) for number in (signal.SIGINT, signal.SIGTERM)}
        return self

    def __exit__(self, *error: object) -> None:
        for number, handler in self._earlier.items():
            signal.signal(number, handler)

    def _stop(self, number: int, frame: object) -> None:
        with self._lock:
            if self.signal is not None:
                raise SystemExit(128 + number)
            self.signal = number
            for worker in self._running:
                worker.send_signal(number)

    def pass_on_to(self, worker: subprocess.Popen[str]) -> None:
        """Let `worker` receive the signal, once, also if it has arrived already."""
        with self._lock:
            self._running = [other for other in self._running if other.poll() is None] + [worker]
            if self._ended:
                worker.kill()
            elif self.signal is not None:
                worker.send_signal(self.signal)

    @contextlib.contextmanager
    def ending_workers(self) -> Iterator[None]:
        """End all workers that still run when the context ends, as after an error or a second signal."""
        try:
            yield
        finally:
            with self._lock:
                self._ended = True
                running = list(self._running)
            for worker in running:
                worker.kill()
            for worker in running:
                worker.wait()


@contextlib.contextmanager
def relayed_lines(stream: IO[str] | None) -> Iterator[None]:
    """Write what arrives in `stream` to stderr, line by line, so that lines of several workers do not mix."""
    if stream is None:
        yield
        return

    def relay() -> None:
        for line in stream:
            sys.stderr.write(line)

    thread = threading.Thread(target=relay, daemon=True)
    thread.start()
    try:
        yield
    finally:
        thread.join()


def concurrent_events(
    tasks: Iterable[Task],
    slots: Sequence[SlotT],
    stop: ForwardedSignal,
    worker_events: Callable[[Task, ForwardedSignal, SlotT], Iterator[Event]],
) -> Iterator[Event]:
    """Yield the events of the workers of `tasks`, one worker at a time at each of `slots`, as they arrive.

    A task is taken from `tasks` when a slot becomes free, and no more are taken after the signal of `stop`. Whoever
    reads the events works in one thread, so that it can print lines.
    """
    source, lock = iter(tasks), threading.Lock()
    events: queue.SimpleQueue[Event | BaseException | None] = queue.SimpleQueue()

    def next_task() -> Task | None:
        with lock:
            return None if stop.signal is not None else next(source, None)

    def serve(slot: SlotT) -> None:
        try:
            while (task := next_task()) is not None:
                for event in worker_events(task, stop, slot):
                    events.put(event)
        except BaseException as error:
            events.put(error)
        else:
            events.put(None)

    for slot in slots:
        threading.Thread(target=serve, args=(slot,), daemon=True).start()
    busy = len(slots)
    while busy:
        event = events.get()
        if isinstance(event, BaseException):
            raise event
        if event is None:
            busy -= 1
        else:
            yield event
