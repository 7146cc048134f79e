"""The trade-off that the paper's conclusion names: how well and how fast a policy is learnt by the interventions spent.

Source: Sharma et al. 2022, section 7, which asks for it by task and shows no figure. The exhibit is ours: the probability
epsilon of an intervention, and a budget h_max for help that the agent requests (appendix A.2).
"""

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from earl_jax.errors import InputError
from earl_jax.metrics.comparison import LEVEL, holm, mean_interval, verdict
from earl_jax.metrics.scores import deployed_area
from earl_jax.metrics.statistics import Estimate, stderr
from earl_jax.report.runs import Curves, read_all
from earl_jax.report.scores import last_mean
from earl_jax.report.style import (
    colours,
    legend_below,
    legend_entries,
    method_order,
    new_figure,
    reach,
    save,
    task_order,
    task_title,
)
from earl_jax.report.tables import markdown_table, write

KINDS = {"epsilon": "o-", "budget": "s--"}
"""The two ways in which interventions are given, and their lines."""
SPENT = ("interventions", "help/asked", "help/enforced")
"""The metrics whose sum is the number of interventions spent."""
WORDS = {"above": "help", "below": "hurt"}
"""What more interventions do, by the verdict on the correlation."""
DESCRIPTION = (
    "Deployed score and interventions of whole lifetimes, mean over seeds (standard error). Epsilon is the probability of "
    "an intervention after any step, budget the largest total cost of help; both beside the interventions of every H_T "
    "steps. Final: the mean of a seed's last 10 evaluations. D(A): the area under its deployed curve per step, which is "
    "higher if it learns sooner. Interventions: all resets, requested and enforced help included. Ended: share of "
    "seeds whose budget was spent, so that their lifetime ended and they no longer learn. All values of one task, method "
    "and kind are those at the same step, the last one that all of its runs have."
)
RULES = (
    "Finding: Spearman's rank correlation of the final score with the interventions spent, over all seeds of all values, and its "
    f"p. More interventions `help` or `hurt` if p, adjusted by Holm over this table, is below {LEVEL}, else the seeds `cannot "
    "tell`; there is no correlation where all scores are equal. A test of the two ends alone could find nothing in five seeds, "
    "whose smallest p is 0.008. The paper's conclusion names this trade-off and has no numbers for it."
)


class Point(NamedTuple):
    """The lifetimes of one method on one task with one epsilon or budget; arrays are [N] seeds.

    `mean_deployed`: the area under the deployed curve, per step.
    """

    env: str
    algo: str
    kind: str
    value: float
    final: np.ndarray
    mean_deployed: np.ndarray
    spent: np.ndarray
    ended: np.ndarray
    steps: int

    @property
    def name(self) -> tuple[str, str, str, float]:
        """The task, the method, the kind and its value."""
        return self[:4]


def write_tradeoff(folders: Sequence[Path], out: Path) -> list[Path]:
    """Write the trade-off from run folders into `out` and return the files: csv, md, png.

    Raises:
        ValueError: a folder is no run, two runs of one point differ in other options, or matplotlib is not installed.
    """
    points = _points(read_all(folders))
    figure = _draw(points)
    out.mkdir(parents=True, exist_ok=True)
    paths = [out / "tradeoff.csv", out / "tradeoff.md"]
    write([row for point in points for row in _rows(point)], paths[0])
    paths[1].write_text(_markdown(points))
    return [*paths, save(figure, out / "tradeoff.png")]


def _points(runs: Sequence[Curves]) -> list[Point]:
    """Return a point per run, by task, method, kind and value; those of one line at the last step that all have."""
    lines: dict[tuple[str, str, str], list[Curves]] = {}
    for curves in runs:
        lines.setdefault((curves.config.env, curves.config.algo, _kind(curves)), []).append(curves)
    points = [_point(curves, min(int(run.steps[-1]) for run in line)) for line in lines.values() for curves in line]
    names = [point.name for point in points]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        env, algo, kind, value = twice[0]
        raise InputError(f"runs of {algo} on {env} with {kind} {value:g} differ in other options; name one of them")
    envs, algos = task_order(point.env for point in points), method_order(point.algo for point in points)
    kinds = list(KINDS)
    return sorted(
        points,
        key=lambda point: (envs.index(point.env), algos.index(point.algo), kinds.index(point.kind), point.value),
    )


def _kind(curves: Curves) -> str:
    return "epsilon" if curves.config.build_setting().budget is None else "budget"


def _point(curves: Curves, step: int) -> Point:
    """Return the point of one run at `step`."""
    setting, until = curves.config.build_setting(), curves.steps <= step
    metrics = {name: values[:, until] for name, values in curves.metrics.items()}
    scores = metrics[curves.deployed_metric]
    return Point(
        env=curves.config.env,
        algo=curves.config.algo,
        kind=_kind(curves),
        value=float(setting.intervention_chance if setting.budget is None else setting.budget),
        final=last_mean(scores),
        mean_deployed=deployed_area(curves.steps[until], scores),
        spent=np.sum([metrics[name][:, -1] for name in SPENT if name in metrics], axis=0),
        ended=np.zeros(len(scores)) if setting.budget is None else metrics["help/over"][:, -1],
        steps=int(curves.steps[until][-1]),
    )


def _rows(point: Point) -> list[dict[str, Any]]:
    """Return one row per seed."""
    key = {"env": point.env, "algo": point.algo, "kind": point.kind, "value": point.value, "steps": point.steps}
    names = ("interventions", "final", "deployed_area", "ended")
    arrays = dict(zip(names, (point.spent, point.final, point.mean_deployed, point.ended), strict=True))
    return [
        {**key, "lane": lane, **{name: float(values[lane]) for name, values in arrays.items()}}
        for lane in range(len(point.final))
    ]


def _lines(points: Iterable[Point]) -> dict[tuple[str, str, str], list[Point]]:
    """Return the points of each task, method and kind, from the fewest to the most interventions."""
    lines: dict[tuple[str, str, str], list[Point]] = {}
    for point in points:
        lines.setdefault(point.name[:3], []).append(point)
    return {name: sorted(line, key=lambda point: point.spent.mean()) for name, line in lines.items()}


class Finding(NamedTuple):
    """The rank correlation of final scores with the interventions spent, and its two-sided p; nan where scores are equal."""

    correlation: float
    p: float


def finding(line: Sequence[Point]) -> Finding:
    """Return the correlation over all seeds of one line."""
    final, spent = (np.concatenate([getattr(point, name) for point in line]) for name in ("final", "spent"))
    if np.ptp(final) == 0 or np.ptp(spent) == 0:
        return Finding(math.nan, math.nan)
    result: Any = stats.spearmanr(spent, final)  # its stubs know no attributes
    return Finding(float(result.statistic), float(result.pvalue))


def _markdown(points: Sequence[Point]) -> str:
    header = ["env", "method", "varied", "value", "seeds", "steps", "interventions", "final", "D(A)", "ended"]
    table = markdown_table(header, [_line(point) for point in points])
    parts = ["# Learning by interventions: the trade-off of the paper's conclusion", DESCRIPTION, table]
    lines = {name: line for name, line in _lines(points).items() if len(line) > 1}
    if lines:
        header = ["env", "method", "varied", "interventions", "final", "rank correlation", "p", "adjusted p"]
        parts += [markdown_table([*header, "more interventions"], _findings(lines)), RULES]
    return "\n\n".join(parts) + "\n"


def _findings(lines: dict[tuple[str, str, str], list[Point]]) -> list[list[str]]:
    """Return a row of text for the finding of each of `lines`, with its ends."""
    results = [finding(line) for line in lines.values()]
    rows = []
    adjusted = holm([result.p for result in results])
    for (name, line), result, p in zip(lines.items(), results, adjusted, strict=True):
        counts, scores = (
            " to ".join(format(getattr(end, value).mean(), style) for end in (line[0], line[-1]))
            for value, style in (("spent", ",.0f"), ("final", ".3f"))
        )
        numbers = [_number(result.correlation), *(_number(value, least=0.001) for value in (result.p, p))]
        word = verdict(result.correlation, p)
        rows.append([*name, counts, scores, *numbers, WORDS.get(word, word)])
    return rows


def _number(value: float, least: float = -math.inf) -> str:
    if math.isnan(value):
        return "-"
    return f"<{least:g}" if value < least else f"{value:.3f}"


def _line(point: Point) -> list[str]:
    texts = [f"{values.mean():.3f} ({stderr(values):.3f})" for values in (point.final, point.mean_deployed)]
    spent = f"{point.spent.mean():,.1f} ({stderr(point.spent):,.1f})"
    counts = [str(len(point.final)), f"{point.steps:,}", spent]
    return [point.env, point.algo, point.kind, f"{point.value:g}", *counts, *texts, f"{point.ended.mean():.2f}"]


def _draw(points: Sequence[Point]) -> Any:
    """Return a figure with a column per task: final score and area by the interventions spent."""
    envs = list(dict.fromkeys(point.env for point in points))
    figure, axes = new_figure(2, len(envs), (max(4.8 * len(envs), 6.4), 7.0), sharex="col")
    palette = colours(point.algo for point in points)
    for (env, algo, kind), line in _lines(points).items():
        column = axes[:, envs.index(env)]
        for axis, name in zip(column, ("final", "mean_deployed"), strict=True):
            _draw_line(axis, line, name, palette[algo], KINDS[kind], f"{algo}, {kind}")
    for env, column in zip(envs, axes.T, strict=True):
        column[0].set(title=task_title(env), ylabel="final deployed score")
        column[1].set(xscale="symlog", xlabel="interventions spent", ylabel="area under the deployed curve, per step")
        for axis in column:
            axis.grid(alpha=0.3)
    legend_below(figure, legend_entries(axes[0]), 4)
    return figure


def _draw_line(axis: Any, line: Sequence[Point], name: str, colour: str, style: str, label: str) -> None:
    """Draw one line, with the value of epsilon or the budget beside each point."""
    spent = [point.spent.mean() for point in line]
    estimate = Estimate(*zip(*(mean_interval(getattr(point, name)) for point in line), strict=True))
    options = {"color": colour, "label": label, "capsize": 3, "markersize": 5}
    axis.errorbar(spent, estimate.value, reach(estimate), fmt=style, **options)
    for x, y, point in zip(spent, estimate.value, line, strict=True):
        axis.annotate(f"{point.value:g}", (x, y), (4, 4), textcoords="offset points", fontsize="x-small")
