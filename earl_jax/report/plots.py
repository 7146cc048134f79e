"""Learning curves as pictures."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from earl_jax.metrics.statistics import bootstrap, iqm
from earl_jax.report.runs import Curves, label, read_all

PANELS = {"deployed": "Deployed: greedy success from s0", "continuing": "Continuing: reward a step over the lifetime"}
SUFFIXES = (".png", ".pdf", ".svg")


def _metric(panel: str, curves: Curves) -> str:
    if panel == "continuing":
        return "continuing/reward"
    return "deployed/return" if curves.experiment.env_options.get("reward_type") == "dense" else "deployed/success"


def plot_runs(folders: Sequence[Path], out: Path) -> Path:
    """Draw deployed and continuing curves of `folders` to `out` and return it: mean lines, 95 % bands of the IQM.

    Raises:
        ValueError: a folder is no run, `out` has no known picture format, or matplotlib is not installed.
    """
    if out.suffix not in SUFFIXES:
        raise ValueError(f"{out}: pictures are written as {', '.join(SUFFIXES)}")
    runs = read_all(folders)
    figure, axes = _canvas()
    for panel, axis in zip(PANELS, axes, strict=True):
        for number, curves in enumerate(runs):
            _draw(axis, curves, curves.metrics[_metric(panel, curves)], f"C{number}")
        axis.set(title=PANELS[panel], xlabel="environment steps", xlim=(0, None))
        axis.grid(alpha=0.3)
    axes[0].legend(frameon=False, fontsize="small")
    figure.suptitle(", ".join(sorted({curves.experiment.env for curves in runs})))
    out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(out, dpi=150)
    return out


def _canvas() -> tuple[Any, Any]:
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ValueError("plots need matplotlib: pip install 'earl-jax[plot]'") from error
    figure = Figure(figsize=(11, 4), layout="constrained")
    return figure, figure.subplots(1, 2)


def _draw(axis: Any, curves: Curves, values: np.ndarray, colour: str) -> None:
    """Draw the mean over seeds [N, E] and, with several seeds, the bootstrap band of the interquartile mean."""
    name = f"{label(curves)}, {len(values)} seed{'s' * (len(values) > 1)}"
    axis.plot(curves.steps, values.mean(axis=0), color=colour, label=name)
    if len(values) > 2:
        low, high = np.array([bootstrap(column, iqm) for column in values.T]).T
        axis.fill_between(curves.steps, low, high, color=colour, alpha=0.2, linewidth=0)
    else:
        axis.plot(curves.steps, values.T, color=colour, alpha=0.3, linewidth=0.8)
