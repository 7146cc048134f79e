"""Figure 5 of the paper: learning curves, deployed and continuing, one column per task.

Source: Sharma et al. 2022, figure 5.
"""

import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from earl_jax.envs import PAPER_TASKS
from earl_jax.metrics.scores import CONTINUING, SUCCESS, deployed_area
from earl_jax.metrics.statistics import Estimate
from earl_jax.paper.artefact import METHODS, Artefact, Report, Row, mean_text, runs_of
from earl_jax.report import style
from earl_jax.report.paper_rows import columns_of_test
from earl_jax.report.pooling import read_methods
from earl_jax.report.published import published_beside
from earl_jax.report.runs import Curves, options_text
from earl_jax.report.scores import LEVELS, crossings_beside, interval_of, level_crossings, seed_scores, trailing
from earl_jax.report.tables import markdown_table, millions, step_interval

SMOOTH = " (trailing 10)"
LETTERS = 40
"""Letters in a line of the legend, which has half as many columns if names have options."""


def report(folders: Sequence[Path]) -> Report:
    """Return the learning curves of run folders, with rows of their means. Errors as `read_methods` and `new_figure`."""
    runs = read_methods(folders)
    options = [f"- {curves.env}, {curves.label}: {options_text(curves.options)}" for curves in runs]
    crossings = [text for level in LEVELS for text in (f"to {level}", f"published to {level}")]
    header = ["task", "method", "seeds", "steps", *crossings, "D(A)", "C(A)", "published C(A)", "J_D", "published J_D"]
    parts = {"scores": markdown_table(header, [_line(curves) for curves in runs]), "options": "\n".join(options)}
    return Report(parts, _draw(runs), {"": list(_points(runs))})


def _points(runs: Sequence[Curves]) -> Iterator[Row]:
    for curves in runs:
        metrics, deployed = curves.metrics, curves.deployed_metric
        series = {
            deployed: metrics[deployed], deployed + SMOOTH: trailing(metrics[deployed]), CONTINUING: metrics[CONTINUING]
        }  # fmt: skip
        for metric, values in series.items():
            band = interval_of(curves, values, metric.removesuffix(SMOOTH))
            for step, *ends in zip(curves.steps.tolist(), *band, strict=True):
                key = {"env": curves.env, "algo": curves.label, "step": step, "metric": metric}
                yield {**key, **Estimate(*ends).columns("mean"), "seeds": curves.seeds}


def _line(curves: Curves) -> list[str]:
    """Return the line of a run in the table of scores."""
    scores, rewards = curves.metrics[curves.deployed_metric], curves.metrics[CONTINUING]
    crossings, published = [], crossings_beside(curves)
    for level, estimate in level_crossings(curves).items():
        crossings += [step_interval(*estimate), millions(published.get(level))]
    digits = ".3f" if curves.deployed_metric == SUCCESS else ".1f"
    return [
        curves.env,
        curves.label,
        str(curves.seeds),
        f"{curves.length:,}",
        *crossings,
        mean_text(deployed_area(curves.steps, scores), digits),
        mean_text(rewards[:, -1], ".4f"),
        _released_text(2, curves, ".4f"),
        mean_text(seed_scores(curves), digits),
        _released_text(1, curves, digits),
    ]


def _released_text(number: int, curves: Curves, digits: str) -> str:
    """Return the mean score of the released runs over the steps of `curves`, as tested in table `number`; `-` without any."""
    test = columns_of_test(number, curves)
    return format(test["other_mean"], digits) if test else "-"


def _draw(runs: Sequence[Curves]) -> Any:
    tasks = style.grouped(runs, lambda curves: (curves.env, curves.deployed_metric))
    figure, axes = style.new_figure(2, len(tasks), (max(4.4 * len(tasks), 7.0), 6.6), sharex="col")
    palette = style.colours(curves.algo for curves in runs)
    for of_task, column in zip(tasks.values(), axes.T, strict=True):
        for curves in of_task:
            peers = [other.label for other in of_task if other.algo == curves.algo]
            line_style = style.LINE_STYLES[peers.index(curves.label) % len(style.LINE_STYLES)]
            _draw_method(column, curves, palette[curves.algo], line_style)
        metric = of_task[0].deployed_metric
        column[0].set(title=style.task_title(of_task[0].env), ylabel=style.AXES[metric])
        if metric == SUCCESS:
            column[0].set_ylim(-0.04, 1.04)
        column[1].set_ylabel(style.AXES[CONTINUING])
        column[0].set_xlim(0, max(curves.length for curves in of_task))
        style.step_axis(column[1])
        for axis in column:
            axis.grid(alpha=0.3)
    _add_legend(figure, axes)
    return figure


def _draw_method(column: Any, curves: Curves, colour: str, line_style: str) -> None:
    """Draw both curves of a method, published final values as dashes at the right edge, and crossings as crosses."""
    label, metrics, deployed = style.method_title(curves.label), curves.metrics, curves.deployed_metric
    drawn = {deployed: trailing(metrics[deployed]), CONTINUING: metrics[CONTINUING]}
    for axis, (metric, values), number in zip(column, drawn.items(), (1, 2), strict=True):
        style.draw_band(
            axis, curves.steps, interval_of(curves, values, metric), colour, linestyle=line_style, label=label
        )
        if final := published_beside(number, curves):
            edge = axis.get_yaxis_transform()
            axis.plot([1.015, 1.075], [final.value] * 2, "--", color=colour, linewidth=2, transform=edge, clip_on=False)
    for level, step in crossings_beside(curves).items():
        column[0].plot(step, level, "X", color=colour, markersize=8, markeredgecolor="white", zorder=5)


def _add_legend(figure: Any, axes: Any) -> None:
    entries = style.legend_entries(axes[0]) | {
        "Published, final value": {"color": "0.5", "linestyle": "--", "linewidth": 2},
        "Published mean reaches 0.5, 0.9": {"color": "0.5", "linestyle": "", "marker": "X", "markersize": 7},
    }
    columns = 4 if axes.shape[1] < 3 else 8
    if any("(" in name for name in entries):
        entries, columns = {textwrap.fill(name, LETTERS): look for name, look in entries.items()}, columns // 2
    style.legend_below(figure, entries, min(len(entries), columns), fontsize="small")


FIGURE5 = Artefact("figure5", PAPER_TASKS, runs_of(*METHODS), report, variants=True)
