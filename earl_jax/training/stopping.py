"""Stopping by a signal: training finishes its chunk, saves a checkpoint, and raises `Stopped`."""

import signal
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax


class Stopped(KeyboardInterrupt):
    """Training was stopped by the signal `number` at `step`; its state is saved in `folders`."""

    def __init__(self, number: int, step: int, folders: Sequence[Path]):
        self.number, self.step, self.folders = number, step, list(folders)
        name = signal.Signals(number).name
        remedy = "".join(f"; resume with: earl-jax resume {folder}" for folder in folders[:1])
        super().__init__(f"stopped at step {step} by {name}{remedy}")

    @property
    def exit_code(self) -> int:
        """The exit code of a process that ends by this signal."""
        return 128 + self.number


class StopRequest:
    """A context that records SIGINT and SIGTERM instead of their default actions; a second signal acts at once.

    Handlers that others have installed stay. Several hosts would have to stop at the same step, so they are not stopped.
    """

    def __init__(self):
        self.number: int | None = None
        self._earlier: dict[int, Any] = {}

    def __enter__(self) -> "StopRequest":
        if threading.current_thread() is threading.main_thread() and jax.process_count() == 1:
            defaults = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL}
            for number, default in defaults.items():
                if signal.getsignal(number) == default:
                    self._earlier[number] = signal.signal(number, self._record)
        return self

    def __exit__(self, *error: object) -> None:
        self._restore()

    def _record(self, number: int, frame: object) -> None:
        del frame
        self.number = number
        self._restore()

    def _restore(self) -> None:
        for number, handler in self._earlier.items():
            signal.signal(number, handler)
        self._earlier.clear()
