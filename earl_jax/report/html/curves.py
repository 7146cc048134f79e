"""The numbers behind the plots of a page: curves over a life, thinned and rounded, with their bands."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from earl_jax import assets
from earl_jax.metrics.statistics import bootstrap, iqm
from earl_jax.paper.verdicts import interval, published
from earl_jax.report.html.runs import Line
from earl_jax.report.tables import LEVELS, WINDOW, trailing

POINTS = 250
"""Evaluations of a line that are drawn at most; more would only make the page heavier."""
DIGITS = 5
FEWEST = 3
"""Seeds that a band needs."""


class Panel(NamedTuple):
    """A plot over the steps of a life: its metric (None for the one that the task is judged by) and what it is called."""

    metric: str | None
    title: str
    unit: str
    needed: bool = True
    """Whether it is drawn where all of it is 0 as well."""


PANELS = (
    Panel(None, "Deployed, from s₀", "{} of the greedy task policy"),
    Panel("continuing/reward", "Continuing", "task reward a step, over the life so far"),
    Panel("interventions", "Interventions", "since birth"),
    Panel("reached", "Goals reached", "by the task controller", needed=False),
    Panel("faults", "Faults", "enforced by a broken simulation", needed=False),
    Panel("help/asked", "Help asked for", "since birth"),
    Panel("help/enforced", "Help enforced", "in irreversible states", needed=False),
    Panel("help/budget", "Budget left", "for interventions"),
    Panel("help/over", "Lives over", "share of seeds whose budget is spent", needed=False),
)


def panels(lines: Sequence[Line]) -> list[dict[str, Any]]:
    """Return the plots of one task's `lines`: title, unit, and the numbers of every line that has the metric."""
    found = []
    for panel in PANELS:
        drawn = [(line, panel.metric or line.cell.curves.deployed_metric) for line in lines]
        drawn = [(line, metric) for line, metric in drawn if metric in line.cell.curves.metrics]
        values = [line.cell.curves.metrics[metric] for line, metric in drawn]
        if not drawn or not (panel.needed or any(part.any() for part in values)):
            continue
        metric = drawn[0][1]
        rates = metric == "deployed/success"
        found.append(
            {
                "title": panel.title,
                "unit": panel.unit.format("success" if rates else "return"),
                "range": [-0.04, 1.04] if rates else None,
                "digits": 3 if rates else DIGITS,
                "lines": [_drawn(line, metric) for line, metric in drawn],
            }
        )
    return found


def _drawn(line: Line, metric: str) -> dict[str, Any]:
    curves = line.cell.curves
    values = curves.metrics[metric]
    kept = thinned(len(curves.steps))
    smooth = metric == curves.deployed_metric and len(curves.steps) >= 2 * WINDOW
    return {
        "line": line.key,
        "x": curves.steps[kept].tolist(),
        "plain": banded(values[:, kept]),
        "smooth": banded(trailing(values)[:, kept]) if smooth else None,
        "seeds": line.seeds,
        "published": _published(line, metric),
    }


def thinned(count: int) -> np.ndarray:
    """Return which of `count` evaluations are drawn: all, or `POINTS` evenly spaced ones with the first and the last."""
    return np.unique(np.linspace(0, count - 1, min(count, POINTS)).round().astype(int))


def banded(values: np.ndarray) -> dict[str, Any]:
    """Return the mean of `values [N, E]`, the 95 % band of the interquartile mean where seeds suffice, and every seed."""
    few = len(values) < FEWEST
    low, high = (None, None) if few else np.array([_band(column) for column in values.T]).T
    return {"mean": _plain(values.mean(axis=0)), "low": _plain(low), "high": _plain(high), "each": _plain(values)}


def _band(scores: np.ndarray) -> tuple[float, float]:
    """Return the bootstrap interval of the interquartile mean of `scores [N]`, at once where all are the same."""
    same = float(scores[0])
    return (same, same) if (scores == same).all() else bootstrap(scores, iqm)


def _plain(values: np.ndarray | None) -> Any:
    """Return `values` as lists of short numbers, None for what is not finite, as JSON wants it."""
    if values is None:
        return None
    if values.ndim > 1:
        return [_plain(part) for part in values]
    return [float(f"{value:.{DIGITS}g}") if np.isfinite(value) else None for value in values.tolist()]


def _published(line: Line, metric: str) -> dict[str, Any] | None:
    """Return what the paper printed of this line: its final value with the interval, and the steps of its crossings."""
    cell = line.cell
    tables = {cell.curves.deployed_metric: "table1", "continuing/reward": "table2"}
    if metric not in tables or not cell.curves.comparable:
        return None
    printed = published(tables[metric], cell.env, cell.algo)
    row = assets.published_row("crossings", env=cell.env, algo=cell.algo) if metric == "deployed/success" else {}
    crossings = [[int(row[f"steps_to_{level}"]), level] for level in LEVELS if row.get(f"steps_to_{level}")]
    bounds = interval(*printed) if printed else None
    if bounds is None or printed is None:
        return {"final": None, "crossings": crossings} if crossings else None
    text = printed[0] + ("" if printed[1] == "-" else f" ({printed[1]})")
    lived = assets.published_row("steps", env=cell.env)
    text += f" after {int(lived['low']):,} steps" if lived else ""
    return {"final": [float(printed[0].lstrip("<")), *bounds, text], "crossings": crossings}
