"""Progress on stderr: a bar with score and speed on a terminal, else a line per evaluation and one a minute."""

import contextlib
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress as Bar, TextColumn, TimeRemainingColumn

from earl_jax.metrics.continuing import DIVERGED, OVER, mostly_faults
from earl_jax.runs.streams import LastingStream

NONE = np.zeros(1)
SMOOTHING = 0.8
SILENCE = 60.0
"""Seconds without a line after which piped output gets one."""


def stderr_console() -> Console:
    """Return a console on stderr that can show a bar if stderr is a terminal; FORCE_COLOR, as in a notebook, makes none."""
    stream: Any = LastingStream(sys.stderr)
    return Console(file=stream, force_terminal=stream.isatty())


class Progress:
    """A context that shows steps and evaluations on stderr; without `show` it prints nothing.

    `metric` names the deployed metric whose mean is shown. The first call of a program compiles it: `working` says so.
    If stderr is not a terminal, a thread prints a line after each `SILENCE` without one, also during compilation.
    """

    def __init__(self, *, label: str, steps: int, metric: str, show: bool, compile_time: str = "about 10 s"):
        self._steps, self._metric, self._speed, self._done = steps, metric, 0.0, 0
        console = stderr_console()
        self._stream = console.file
        self._bar = Bar(
            BarColumn(bar_width=None), TextColumn("{task.completed:,.0f}/{task.total:,.0f} steps"),
            TextColumn(f"{metric.split('/')[-1]} {{task.fields[score]}}  {{task.fields[speed]}} steps/s"), TimeRemainingColumn(),
            console=console, disable=not (show and console.is_terminal), expand=True,
        )  # fmt: skip
        self._plain = show and not console.is_terminal
        self._task = self._bar.add_task(label, total=steps, score="-", speed="-")
        self._compiled: set[str] = set()
        self._compile_time = compile_time
        self._compiling, self._work, self._work_start = False, "starting", time.monotonic()
        self._timed: tuple[float, int] | None = None
        self._last_line, self._ended = time.monotonic(), threading.Event()

    def __enter__(self) -> "Progress":
        if not self._bar.disable:
            self.message(self._bar.tasks[0].description)  # beside the bar, the two need more than 80 columns
        self._bar.start()
        if self._plain:
            threading.Thread(target=self._break_silence, daemon=True).start()
        return self

    def __exit__(self, *error: object) -> None:
        self._ended.set()
        self._bar.stop()

    def message(self, text: str) -> None:
        """Print a line above the bar."""
        if self._plain:
            self._print(text)
        elif not self._bar.disable:
            self._bar.console.print(text, highlight=False)

    def start_at(self, step: int) -> None:
        """Show that `step` steps are complete already."""
        self._done = step
        self._bar.reset(self._task, completed=step)

    @contextlib.contextmanager
    def working(self, work: str) -> Iterator[None]:
        """Show that the program does `work` until the context ends; the first time, that it is compiled for that."""
        self._compiling = work not in self._compiled
        self._work, self._work_start = work, time.monotonic()
        if self._compiling:
            self.message(f"{work}: compiling ({self._compile_time}) ...")
        yield
        if self._compiling:
            self._compiled.add(work)
            self._timed = None  # the time of a compilation says nothing about the time left
            self.message(f"{work}: the first call took {time.monotonic() - self._work_start:.0f} s")

    def advance(self, steps: int, seconds: float) -> None:
        """Add `steps` of every lane, which took `seconds`; the displayed speed is that of a lane, as are the steps.

        A call that compiled counts for the speed until another one has been timed.
        """
        self._done += steps
        speed = steps / max(seconds, 1e-9)  # the clock can be too coarse
        if self._compiling:
            self._speed = self._speed or speed
        elif self._timed is None:
            self._speed = speed
            self._timed = time.monotonic() - seconds, self._done - steps
        else:
            self._speed = SMOOTHING * self._speed + (1 - SMOOTHING) * speed
        self._bar.update(self._task, advance=steps, speed=self._speed_text())

    def report(self, step: int, metrics: Mapping[str, np.ndarray]) -> None:
        """Show an evaluation: the deployed metric and the continuing reward, means over seeds of `metrics [N]`."""
        score, reward = (metrics[name].mean(dtype=float) for name in (self._metric, "continuing/reward"))
        self._bar.update(self._task, score=f"{score:.2f}")
        problems = {
            "have diverged (a loss or a parameter is not finite)": metrics.get(DIVERGED, NONE) > 0,
            "learn nothing more: their budget is spent": metrics.get(OVER, NONE) > 0,
            "have faults in most steps, from which they do not learn": mostly_faults(metrics.get("faults", NONE), step),
        }
        for problem, marks in problems.items():
            if marks.any():
                self.message(f"step {step}: {marks.sum()} of {len(marks)} lanes {problem}")
        if self._plain:
            line = f"step {step}/{self._steps}  {self._metric} {score:.3f}  continuing/reward {reward:.5f}"
            self._print(f"{line}  {self._pace()}")

    def _pace(self) -> str:
        """Return the speed and the time left, evaluations included, as far as they are known."""
        speed = f"steps/s {self._speed_text()}"
        if self._timed is None or self._done <= self._timed[1] or self._done >= self._steps:
            return speed
        start, first = self._timed
        left = (time.monotonic() - start) / (self._done - first) * (self._steps - self._done)
        return f"{speed}  time left {duration(left)}"

    def _speed_text(self) -> str:
        return f"{self._speed:.1f}" if self._speed < 10 else f"{self._speed:,.0f}"

    def _break_silence(self) -> None:
        """Print a line whenever none was printed for the time of `SILENCE`, until the context ends."""
        while not self._ended.wait(max(0.0, self._last_line + SILENCE - time.monotonic())):
            now = time.monotonic()
            if now - self._last_line < SILENCE:
                continue
            if self._compiling:
                took = f"{now - self._work_start:.0f} s"
                self._print(f"{self._work}: still in the first call, which compiles, after {took}")
            else:
                self._print(f"step {self._done}/{self._steps}  {self._work}  {self._pace()}")

    def _print(self, line: str) -> None:
        self._last_line = time.monotonic()
        print(line, file=self._stream, flush=True)


def duration(seconds: float) -> str:
    """Return `seconds` as a user reads them: `45 s`, `12 min`, `3 h 05 min`."""
    minutes = round(seconds / 60)
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02d} min"
