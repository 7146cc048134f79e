"""Learning curves as pictures."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from earl_jax.errors import InputError
from earl_jax.metrics.comparison import mean_interval
from earl_jax.report.life_columns import SHARES
from earl_jax.report.runs import Curves, labels, read_all
from earl_jax.report.style import PICTURES, new_figure, save
from earl_jax.report.tables import seeds_text

PANELS = {"deployed": "Deployed, from s0", "continuing": "Continuing, over the lifetime"}
AXES = {"deployed/success": "success", "deployed/return": "return", "continuing/reward": "reward per step"}


def plot_runs(folders: Sequence[Path], out: Path, metric: str | None = None) -> Path:
    """Draw deployed and continuing curves of `folders`, means with Student's 95 % bands, and return `out`.

    `metric`, a column of metrics.csv, takes the place of the deployed one.

    Raises:
        ValueError: a folder is no run or has no such metric, `out` has an unknown suffix, or matplotlib is not installed.
    """
    if out.suffix not in PICTURES:
        raise InputError(f"{out}: pictures are written as {', '.join(PICTURES)}")
    runs = read_all(folders)
    figure, axes = new_figure(1, 2, (10, 4.2))
    for panel, axis in zip(PANELS, axes[0], strict=True):
        for number, (curves, name) in enumerate(zip(runs, labels(runs), strict=True)):
            _draw(axis, curves, curves.metrics[_metric(panel, curves, metric)], f"C{number}", name)
        drawn = _metric(panel, runs[0], metric)
        title = PANELS[panel] if drawn in AXES else drawn
        axis.set(
            title=title,
            ylabel=AXES.get(drawn, drawn.rpartition("/")[2]),
            xlabel="environment steps of a seed",
            xlim=(0, None),
        )
        if drawn in SHARES:
            axis.set_ylim(-0.03, 1.03)  # Student's intervals of few seeds reach beyond
        axis.xaxis.set_major_formatter("{x:,.0f}")
        axis.locator_params(axis="x", nbins=6)
        axis.grid(alpha=0.3)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
    figure.suptitle(", ".join(sorted({curves.config.env for curves in runs})))
    return save(figure, out)


def _metric(panel: str, curves: Curves, metric: str | None) -> str:
    return "continuing/reward" if panel == "continuing" else metric or curves.deployed_metric


def _draw(axis: Any, curves: Curves, values: np.ndarray, colour: str, name: str) -> None:
    """Draw the mean over seeds of `values [N, E]` with Student's band, or with each of up to two seeds."""
    mean, low, high = mean_interval(values)
    axis.plot(curves.steps, mean, color=colour, label=f"{name}, {seeds_text(len(values))}")
    if len(values) > 2:
        axis.fill_between(curves.steps, low, high, color=colour, alpha=0.2, linewidth=0)
    else:
        axis.plot(curves.steps, values.T, color=colour, alpha=0.3, linewidth=0.8)
