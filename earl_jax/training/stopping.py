"""Stopping before the last step, by a signal or a time limit: training finishes its chunk and saves a checkpoint.

After a signal, training raises `Stopped`; at the end of its time limit, it returns the state that it has reached.
"""

import contextlib
import signal
import sys
import threading
from pathlib import Path
from typing import Any

import jax

from earl_jax.options.imports import resume_command
from earl_jax.options.values import TimeLimit
from earl_jax.runs.hosts import of_all_hosts
from earl_jax.runs.streams import LastingStream


class Stopped(KeyboardInterrupt):
    """Training was stopped by the signal `number` at `step`, in `state`, which is saved in `folder`, if there is one.

    `exit_code` is that of a process killed by this signal. If `train` or `resume` raised it, `result` is the `Result`.
    """

    result: Any = None

    def __init__(self, number: int, step: int, folder: Path | None, state: Any = None):
        self.step, self.state, self.exit_code = step, state, 128 + number
        remedy = f"; resume with: {resume_command(folder)}" if folder else ""
        super().__init__(f"stopped at step {step} by {signal.Signals(number).name}{remedy}")


class StopRequest:
    """A context that records SIGINT, SIGTERM and SIGHUP instead of their default actions; a second signal acts at once.

    Handlers that other code has installed stay, and signals that are ignored, for example by `nohup`, stay ignored.
    Several hosts have to stop at the same step: a signal to any host, or its time limit, counts for all from the next
    `check` on.
    """

    def __init__(self, limit: TimeLimit | None = None):
        self.number: int | None = None
        self._received, self._limit, self._timed_out = 0, limit, False
        self._earlier: dict[int, Any] = {}

    @property
    def requested(self) -> bool:
        """Whether a signal has arrived, or the time limit had passed at the last `check`."""
        return self.number is not None or self._timed_out

    def check(self) -> None:
        """Request a stop if the limit has passed or a host got a signal; all hosts must call it at the same steps."""
        received, passed = of_all_hosts([self._received, self._limit is not None and self._limit.passed]).T
        self.number, self._timed_out = int(received.max()) or self.number, bool(passed.any())

    def __enter__(self) -> "StopRequest":
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
                if signal.getsignal(number) in (signal.default_int_handler, signal.SIG_DFL):
                    self._earlier[number] = signal.signal(number, self._record)
        return self

    def __exit__(self, *error: object) -> None:
        self._restore()

    def _record(self, number: int, frame: object) -> None:
        self._received = number
        if jax.process_count() == 1:
            self.number = number
        self._restore()
        name = signal.Signals(number).name
        with contextlib.suppress(RuntimeError):  # the signal interrupted a write to stderr
            print(
                f"{name}: stopping after this chunk of steps; a second one stops at once",
                file=LastingStream(sys.stderr),
            )

    def _restore(self) -> None:
        for number, handler in self._earlier.items():
            signal.signal(number, handler)
        self._earlier.clear()
