"""Progress on stderr: a bar with score and speed on a terminal, else a line per evaluation."""

import sys
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar

from earl_jax.metrics.continuing import DIVERGED

if TYPE_CHECKING:
    from earl_jax.runs.config import Row

SMOOTHING = 0.8


class Progress:
    """A context that shows steps and evaluations on stderr; without `show` it prints nothing.

    `metric` names the deployed metric whose mean is shown; `done` of the `steps` are complete already.
    """

    def __init__(self, *, label: str, lanes: int, steps: int, done: int, metric: str, show: bool):
        self._lanes, self._steps, self._metric, self._speed = lanes, steps, metric, 0.0
        self._console, self._show = Console(stderr=True), show
        self._bar = Bar(
            TextColumn("{task.description}"), BarColumn(), TextColumn("{task.completed:,.0f}/{task.total:,.0f} steps"),
            TextColumn(f"{metric} {{task.fields[score]}}  {{task.fields[speed]}} steps/s"), TimeRemainingColumn(),
            console=self._console, disable=not (show and self._console.is_terminal),
        )  # fmt: skip
        self._plain = show and not self._console.is_terminal
        self._task = self._bar.add_task(label, total=steps, completed=done, score="-", speed="-")

    def __enter__(self) -> "Progress":
        self._bar.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._bar.stop()

    def message(self, text: str) -> None:
        """Print a line above the bar."""
        if self._show:
            self._console.print(text, highlight=False)

    def advance(self, steps: int, seconds: float) -> None:
        """Add `steps` of every lane, which took `seconds`; the displayed speed is the sum over lanes."""
        speed = steps * self._lanes / max(seconds, 1e-9)  # the clock can be too coarse
        self._speed = speed if not self._speed else SMOOTHING * self._speed + (1 - SMOOTHING) * speed
        self._bar.update(self._task, advance=steps, speed=f"{self._speed:,.0f}")

    def report(self, step: int, rows: list["Row"]) -> None:
        """Show an evaluation: the deployed metric and the continuing reward, means over seeds."""
        score, reward = (sum(row[name] for row in rows) / len(rows) for name in (self._metric, "continuing/reward"))
        self._bar.update(self._task, score=f"{score:.2f}")
        diverged = sum(row.get(DIVERGED, 0) > 0 for row in rows)
        if diverged:
            self.message(
                f"step {step}: {diverged} of {len(rows)} lanes have diverged (a loss or a parameter is not finite)"
            )
        if self._plain:
            line = f"step {step}/{self._steps}  {self._metric} {score:.3f}  continuing/reward {reward:.5f}"
            print(f"{line}  steps/s {self._speed:.0f}", file=sys.stderr, flush=True)
