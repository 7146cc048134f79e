"""The lines of a page, and the numbers behind its plots: curves over the lifetime, thinned and rounded, with their bands."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from earl_jax.metrics.comparison import FEWEST_SEEDS
from earl_jax.metrics.continuing import DIVERGED, OVER
from earl_jax.metrics.deployed import WIDE
from earl_jax.metrics.phase_stats import ALIVE, BACK, FORWARD, STILL
from earl_jax.metrics.scores import CONTINUING, RATES, SUCCESS
from earl_jax.report.published import published_beside, training_steps
from earl_jax.report.runs import Curves, by_method
from earl_jax.report.scores import SMOOTH, crossings_beside, evenly_spaced, interval_of, trailing
from earl_jax.report.style import colours, grouped, lightened, shaded

DASHES = ("solid", "dash", "dot", "dashdot")
POINTS = 250
"""Most evaluations drawn of a line; more would only make the page larger."""
DIGITS = 5


class Line(NamedTuple):
    """The `curves` of a method by `key` on the page, with their colours on a `light` and a `dark` page and line style `dash`."""

    key: str
    curves: Curves
    light: str
    dark: str
    dash: str

    @property
    def seeds(self) -> tuple[int, ...]:
        """The seed of each row of the curves."""
        return tuple(dict.fromkeys(self.curves.run_seeds))


def lines_of(runs: Sequence[Curves]) -> list[Line]:
    """Return a line for each of `runs`, in the paper's order; variants of a method have shades of its colour."""
    lines: list[Line] = []
    palette = colours(curves.algo for curves in runs)
    for (_, algo), peers in grouped(by_method(runs), lambda curves: (curves.env, curves.algo)).items():
        for number, curves in enumerate(peers):
            light = shaded(palette[algo], number, len(peers))
            lines.append(Line(f"c{len(lines)}", curves, light, lightened(light), DASHES[number % len(DASHES)]))
    return lines


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
    Panel(CONTINUING, "Continuing", "task reward per step, over the lifetime so far"),
    Panel(FORWARD, "Forward phases", "share that reached the goal since the last evaluation"),
    Panel(BACK, "Return phases", "share that reached the goal since the last evaluation"),
    Panel(ALIVE, "Lanes alive", "share of seeds that recently reached the goals of both phases"),
    Panel(STILL, "Object at rest", "steps since it last moved"),
    Panel("interventions", "Interventions", "since the first step"),
    Panel("reached", "Goals reached", "by the task controller", always=False),
    Panel(DIVERGED, "Diverged", "share of seeds with a loss or parameter that is not finite", always=False),
    Panel("faults", "Faults", "resets after a broken simulation", always=False),
    Panel("help/asked", "Requested help", "since the first step"),
    Panel("help/enforced", "Enforced help", "in irreversible states", always=False),
    Panel("help/budget", "Remaining budget", "for interventions"),
    Panel(OVER, "Lifetimes over", "share of seeds with a spent budget", always=False),
)
SCORES = PANELS[:3]
"""The plots above the tables; the others are below."""


def panels(lines: Sequence[Line]) -> list[dict[str, Any]]:
    """Return the plots of one task's `lines`: title, unit, and the numbers of every line that has the metric."""
    plots = []
    for panel in PANELS:
        pairs = [(line, panel.metric or line.curves.deployed_metric) for line in lines]
        pairs = [(line, metric) for line, metric in pairs if np.isfinite(line.curves.metrics.get(metric, np.nan)).any()]
        if not pairs or not (panel.always or any(line.curves.metrics[metric].any() for line, metric in pairs)):
            continue
        rates = pairs[0][1] in RATES
        plots.append(
            {
                "title": panel.title,
                "score": panel in SCORES,
                "unit": panel.unit.format("success" if rates else "return"),
                "range": [-0.04, 1.04] if rates else None,
                "digits": 3 if rates else DIGITS,
                "lines": [_curve(line, metric) for line, metric in pairs],
            }
        )
    return plots


def _curve(line: Line, metric: str) -> dict[str, Any]:
    curves, values = line.curves, line.curves.metrics[metric]
    count = len(curves.steps)
    indices = evenly_spaced(count, POINTS)
    smooth = metric == curves.deployed_metric and count >= 2 * SMOOTH
    return {
        "line": line.key,
        "label": curves.label,
        "dash": line.dash,
        "x": curves.steps[indices].tolist(),
        "plain": _banded(curves, values[:, indices], metric),
        "smooth": _banded(curves, trailing(values)[:, indices], metric) if smooth else None,
        "published": _published(line, metric),
    }


def _banded(curves: Curves, values: np.ndarray, metric: str) -> dict[str, Any]:
    """Return the mean of `values [N, E]` of a metric, the 95 % band if seeds suffice, and every seed."""
    mean, low, high = map(_short, interval_of(curves, values, metric))
    if len(values) < FEWEST_SEEDS:
        low = high = None
    return {"mean": mean, "low": low, "high": high, "each": [_short(seed) for seed in values]}


def _short(values: np.ndarray) -> list[float | None]:
    """Return `values [E]` as short numbers; one that is not finite becomes None, since JSON has none."""
    return [float(f"{value:.{DIGITS}g}") if np.isfinite(value) else None for value in values.tolist()]


def _published(line: Line, metric: str) -> dict[str, Any] | None:
    """Return the published numbers of this line: the final value with its interval, and the steps of its crossings."""
    number = {line.curves.deployed_metric: 1, CONTINUING: 2}.get(metric)
    score = published_beside(number, line.curves) if number else None
    if score is None:
        return None
    published = crossings_beside(line.curves) if metric == SUCCESS else {}
    crossings = [[step, level] for level, step in published.items()]
    text = f"{score.text} after {training_steps(line.curves.env):,} steps"
    return {"final": [score.value, *score.interval, text], "crossings": crossings}
