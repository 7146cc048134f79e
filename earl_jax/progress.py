"""What a run shows while it runs: a bar with score and speed on a terminal, a line per evaluation elsewhere."""

import sys
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar

if TYPE_CHECKING:
    from earl_jax.experiment import Experiment, Row

SMOOTHING = 0.8


class Progress:
    """A context that is told of steps and evaluations and shows them on stderr."""

    def __init__(self, experiment: "Experiment", done: int, show: bool):
        self._experiment, self._speed, self._metric = experiment, 0.0, experiment.deployed_metric
        self._console, self._show = Console(stderr=True), show
        self._bar = Bar(
            TextColumn("{task.description}"), BarColumn(), TextColumn("{task.completed:,.0f}/{task.total:,.0f} steps"),
            TextColumn(f"{self._metric} {{task.fields[score]}}  {{task.fields[speed]}} steps/s"), TimeRemainingColumn(),
            console=self._console, disable=not (show and self._console.is_terminal),
        )  # fmt: skip
        self._plain = show and not self._console.is_terminal
        label = f"{experiment.algo} x {len(experiment.seeds)} on {experiment.env}"
        self._task = self._bar.add_task(label, total=experiment.steps, completed=done, score="-", speed="-")

    def __enter__(self) -> "Progress":
        self._bar.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._bar.stop()

    def say(self, text: str) -> None:
        """Print a line above the bar."""
        if self._show:
            self._console.print(text, highlight=False)

    def advance(self, steps: int, seconds: float) -> None:
        """Count `steps` of every lane that took `seconds`; the speed shown is of all lanes together."""
        now = steps * len(self._experiment.seeds) / max(seconds, 1e-9)  # a clock may stand still
        self._speed = now if not self._speed else SMOOTHING * self._speed + (1 - SMOOTHING) * now
        self._bar.update(self._task, advance=steps, speed=f"{self._speed:,.0f}")

    def report(self, step: int, rows: list["Row"]) -> None:
        """Show an evaluation: what the task is judged by when deployed, and continuing reward, means over seeds."""
        score, reward = (sum(row[name] for row in rows) / len(rows) for name in (self._metric, "continuing/reward"))
        self._bar.update(self._task, score=f"{score:.2f}")
        if self._plain:
            line = f"step {step}/{self._experiment.steps}  {self._metric} {score:.3f}  continuing/reward {reward:.5f}"
            print(f"{line}  steps/s {self._speed:.0f}", file=sys.stderr, flush=True)
