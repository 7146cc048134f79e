"""The paper's learning curves: deployed and continuing, one column per task."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from earl_jax.metrics.comparison import mean_interval
from earl_jax.metrics.scores import deployed_area
from earl_jax.metrics.statistics import Estimate, stderr
from earl_jax.report.published import LEVELS, crossings_beside, published_beside
from earl_jax.report.runs import MethodRuns, options_text, read_methods
from earl_jax.report.scores import level_crossings, trailing
from earl_jax.report.style import (
    LINE_STYLES,
    colours,
    draw_band,
    legend_below,
    legend_entries,
    new_figure,
    save,
    step_axis,
    task_title,
)
from earl_jax.report.tables import markdown_table, millions, step_interval, write

CONTINUING, SUCCESS = "continuing/reward", "deployed/success"
SMOOTH = " (trailing 10)"
DESCRIPTION = (
    "Deployed performance from s0 (mean of the trailing 10 evaluations) and reward per step over the lifetime. A "
    "line is the mean over seeds, its band Student's 95 % interval of that mean. Dashes at the right edge are "
    "the published final values. Crosses are the steps at which the published mean curves first reached 0.5 and 0.9. "
    "curves.csv has single evaluations as well."
)
COLUMNS = (
    "`to 0.5` and `to 0.9`: the step at which the mean curve, over the evaluations of the last 100,000 steps, first "
    "reached that success, with a 95 % interval (`-`: not within the run, or the task is scored by return). D(A): the "
    "area under the deployed curve divided by the steps, where each evaluation stands for the steps since the one "
    "before; the paper's D(A) is the gap between that and the best policy. C(A): reward per step over the lifetime. "
    "J_D: the last evaluation. Brackets: standard errors."
)


def write_curves(folders: Sequence[Path], out: Path) -> list[Path]:
    """Write the learning curves of run folders into `out` and return the files: curves.csv, curves.md, curves.png.

    Raises:
        ValueError: a folder is no run or has no evaluation, or matplotlib is not installed.
    """
    groups = read_methods(folders)
    rows = list(_points(groups))
    figure = _draw(groups, rows)
    out.mkdir(parents=True, exist_ok=True)
    write(rows, out / "curves.csv")
    (out / "curves.md").write_text(_markdown(groups))
    return [out / "curves.csv", out / "curves.md", save(figure, out / "curves.png")]


def _metrics(group: MethodRuns) -> tuple[str, str]:
    return group.curves.deployed_metric, CONTINUING


def _points(groups: Sequence[MethodRuns]) -> Iterator[dict[str, Any]]:
    """Yield the mean and its interval at every evaluation of every group, of deployed metrics also smoothed."""
    for group in groups:
        deployed, lifetime = (group.curves.metrics[metric] for metric in _metrics(group))
        names = (group.curves.deployed_metric, group.curves.deployed_metric + SMOOTH, CONTINUING)
        for metric, values in zip(names, (deployed, trailing(deployed), lifetime), strict=True):
            for step, scores in zip(group.curves.steps.tolist(), values.T, strict=True):
                estimate = mean_interval(scores)
                yield {
                    "env": group.env,
                    "algo": group.label,
                    "step": step,
                    "metric": metric,
                    "mean": estimate.value,
                    "low": estimate.low,
                    "high": estimate.high,
                    "seeds": len(scores),
                }


def _markdown(groups: Sequence[MethodRuns]) -> str:
    header = ["env", "algo", "seeds", "steps"]
    header += [text for level in LEVELS for text in (f"to {level}", "published")]
    header += ["D(A)", "C(A)", "published", "J_D", "published"]
    notes = [f"- {group.env}, {group.label}: {options_text(group.curves.options)}" for group in groups]
    parts = ["# Learning curves", DESCRIPTION, markdown_table(header, [_line(group) for group in groups]), COLUMNS]
    return "\n\n".join([*parts, "\n".join(["Options:", "", *notes])]) + "\n"


def _line(group: MethodRuns) -> list[str]:
    scores, rewards = (group.curves.metrics[metric] for metric in _metrics(group))
    steps = group.curves.steps
    crossings, published = [], crossings_beside(group.curves)
    for level, estimate in level_crossings(group.curves).items():
        crossings += [step_interval(estimate), millions(published.get(level))]
    deployed, continuing = (published_beside(table, group.curves) for table in ("table1", "table2"))
    digits = 3 if group.curves.deployed_metric == SUCCESS else 1
    return [
        group.env,
        group.label,
        str(len(scores)),
        f"{steps[-1]:,}",
        *crossings,
        _mean_text(deployed_area(steps, scores), digits),
        _mean_text(rewards[:, -1], 4),
        continuing.mean if continuing else "-",
        _mean_text(scores[:, -1], digits),
        deployed.mean if deployed else "-",
    ]


def _mean_text(values: np.ndarray, digits: int) -> str:
    return f"{values.mean():.{digits}f} ({stderr(values):.{digits}f})"


def _draw(groups: Sequence[MethodRuns], rows: Sequence[dict[str, Any]]) -> Any:
    """Return the figure of `rows`, the points of `groups`."""
    envs = list(dict.fromkeys(group.env for group in groups))
    figure, axes = new_figure(2, len(envs), (max(4.4 * len(envs), 7.0), 6.6), sharex="col")
    palette = colours(group.algo for group in groups)
    for env, column in zip(envs, axes.T, strict=True):
        of_task = [group for group in groups if group.env == env]
        for group in of_task:
            peers = [other.label for other in of_task if other.algo == group.algo]
            line_style = LINE_STYLES[peers.index(group.label) % len(LINE_STYLES)]
            for axis, metric in zip(column, _metrics(group), strict=True):
                _draw_curve(axis, _curve_rows(rows, group, metric), palette[group.algo], line_style, group.label)
                _draw_published(axis, group, metric, palette[group.algo])
        _format_column(column, of_task)
    _add_legend(figure, axes)
    return figure


def _curve_rows(rows: Sequence[dict[str, Any]], group: MethodRuns, metric: str) -> list[dict[str, Any]]:
    """Return the points of the curve drawn for `metric`: the smoothed one of a deployed metric."""
    name = metric if metric == CONTINUING else metric + SMOOTH
    return [row for row in rows if (row["env"], row["algo"], row["metric"]) == (group.env, group.label, name)]


def _format_column(column: Any, of_task: Sequence[MethodRuns]) -> None:
    """Label the two axes of one task."""
    rates = of_task[0].curves.deployed_metric == SUCCESS
    column[0].set(title=task_title(of_task[0].env), ylabel="deployed success" if rates else "deployed return")
    if rates:
        column[0].set_ylim(-0.04, 1.04)
    column[1].set_ylabel("reward per step of the lifetime")
    column[0].set_xlim(0, max(group.curves.steps[-1] for group in of_task))
    step_axis(column[1], "steps of a seed")
    for axis in column:
        axis.grid(alpha=0.3)


def _add_legend(figure: Any, axes: Any) -> None:
    from matplotlib.lines import Line2D

    handles = legend_entries(axes[0])
    handles["published: final value"] = Line2D([], [], color="0.5", linestyle="--", linewidth=2)
    handles["published: 0.5, 0.9 reached"] = Line2D([], [], color="0.5", linestyle="", marker="X", markersize=7)
    legend_below(figure, handles, min(len(handles), 4 if axes.shape[1] < 3 else 8), fontsize="small")


def _draw_curve(axis: Any, rows: Sequence[dict[str, Any]], colour: str, line_style: str, name: str) -> None:
    estimate = Estimate(*(np.array([row[key] for row in rows]) for key in ("mean", "low", "high")))
    style = {"linestyle": line_style, "label": name, "marker": "o" if len(rows) == 1 else None}
    draw_band(axis, [row["step"] for row in rows], estimate, colour, **style)


def _draw_published(axis: Any, group: MethodRuns, metric: str, colour: str) -> None:
    """Draw the published final value as a dash at the right edge, and published crossings as crosses."""
    final = published_beside("table2" if metric == CONTINUING else "table1", group.curves)
    if final:
        edge = axis.get_yaxis_transform()
        axis.plot([1.015, 1.075], [final.value] * 2, "--", color=colour, linewidth=2, transform=edge, clip_on=False)
    if metric != CONTINUING:
        for level, step in crossings_beside(group.curves).items():
            axis.plot(step, level, "X", color=colour, markersize=8, markeredgecolor="white", zorder=5)
