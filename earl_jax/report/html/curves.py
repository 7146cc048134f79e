"""The numbers behind the plots of a page: curves over the lifetime, thinned and rounded, with their bands."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from earl_jax.metrics.comparison import mean_interval
from earl_jax.metrics.continuing import DIVERGED
from earl_jax.metrics.deployed import WIDE
from earl_jax.metrics.life import ALIVE, BACK, FORWARD, STILL
from earl_jax.report.html.lines import Line
from earl_jax.report.published import crossings_beside, published_beside, published_steps
from earl_jax.report.scores import SHARES, WINDOW, trailing

POINTS = 250
"""Most evaluations drawn of a line; more would only make the page larger."""
DIGITS = 5
FEWEST = 3
"""Fewest seeds that have a band."""


class Panel(NamedTuple):
    """A plot over the steps of a lifetime: its metric (None for the deployed metric of the task), title and unit."""

    metric: str | None
    title: str
    unit: str
    always: bool = True
    """Whether it is also drawn if all its values are 0."""


PANELS = (
    Panel(None, "Deployed, from s₀", "{} of the greedy task policy"),
    Panel(WIDE, "Deployed, from wide starts", "success of the greedy task policy"),
    Panel("continuing/reward", "Continuing", "task reward per step, over the lifetime so far"),
    Panel(FORWARD, "Forward phases", "share that reached the goal since the last evaluation"),
    Panel(BACK, "Ways back", "share that reached the goal since the last evaluation"),
    Panel(ALIVE, "Lanes alive", "share of seeds that recently reached the goals of both phases"),
    Panel(STILL, "Object at rest", "steps since it last moved"),
    Panel("interventions", "Interventions", "since the first step"),
    Panel("reached", "Goals reached", "by the task controller", always=False),
    Panel(DIVERGED, "Diverged", "seeds with a loss or parameter that is not finite", always=False),
    Panel("faults", "Faults", "resets after a broken simulation", always=False),
    Panel("help/asked", "Requested help", "since the first step"),
    Panel("help/enforced", "Enforced help", "in irreversible states", always=False),
    Panel("help/budget", "Remaining budget", "for interventions"),
    Panel("help/over", "Lifetimes over", "share of seeds with a spent budget", always=False),
)


def panels(lines: Sequence[Line]) -> list[dict[str, Any]]:
    """Return the plots of one task's `lines`: title, unit, and the numbers of every line that has the metric."""
    plots = []
    for panel in PANELS:
        pairs = [(line, panel.metric or line.curves.deployed_metric) for line in lines]
        pairs = [(line, metric) for line, metric in pairs if metric in line.curves.metrics]
        if not pairs or not (panel.always or any(line.curves.metrics[metric].any() for line, metric in pairs)):
            continue
        rates = pairs[0][1] in SHARES
        plots.append(
            {
                "title": panel.title,
                "unit": panel.unit.format("success" if rates else "return"),
                "range": [-0.04, 1.04] if rates else None,
                "digits": 3 if rates else DIGITS,
                "lines": [_curve(line, metric) for line, metric in pairs],
            }
        )
    return plots


def _curve(line: Line, metric: str) -> dict[str, Any]:
    curves = line.curves
    values = curves.metrics[metric]
    indices = thinned(len(curves.steps))
    smooth = metric == curves.deployed_metric and len(curves.steps) >= 2 * WINDOW
    return {
        "line": line.key,
        "x": curves.steps[indices].tolist(),
        "plain": banded(values[:, indices]),
        "smooth": banded(trailing(values)[:, indices]) if smooth else None,
        "seeds": line.seeds,
        "published": _published(line, metric),
    }


def thinned(count: int) -> np.ndarray:
    """Return the indices of the drawn ones of `count` evaluations: all, or `POINTS` from the first to the last."""
    return np.unique(np.linspace(0, count - 1, min(count, POINTS)).round().astype(int))


def banded(values: np.ndarray) -> dict[str, Any]:
    """Return the mean of `values [N, E]`, Student's 95 % band if seeds suffice, and every seed."""
    mean, low, high = mean_interval(values)
    if len(values) < FEWEST:
        low = high = None
    return {"mean": _plain(mean), "low": _plain(low), "high": _plain(high), "each": _plain(values)}


def _plain(values: np.ndarray | None) -> Any:
    """Return `values` as lists of short numbers; a number that is not finite becomes None, since JSON has none."""
    if values is None:
        return None
    if values.ndim > 1:
        return [_plain(part) for part in values]
    return [float(f"{value:.{DIGITS}g}") if np.isfinite(value) else None for value in values.tolist()]


def _published(line: Line, metric: str) -> dict[str, Any] | None:
    """Return the published numbers of this line: the final value with its interval, and the steps of its crossings."""
    tables = {line.curves.deployed_metric: "table1", "continuing/reward": "table2"}
    if metric not in tables:
        return None
    published = crossings_beside(line.curves) if metric == "deployed/success" else {}
    crossings = [[step, level] for level, step in published.items()]
    score = published_beside(tables[metric], line.curves)
    if score is None or score.interval is None:
        return {"final": None, "crossings": crossings} if crossings else None
    steps = published_steps(line.group.env)
    text = score.text + (f" after {steps[0]:,} steps" if steps else "")
    return {"final": [score.value, *score.interval, text], "crossings": crossings}
