"""The picture of figure 2: learning curves by H_T for each TD update, and the final return by H_T."""

from collections.abc import Mapping, Sequence
from typing import Any

from earl_jax.metrics.statistics import Estimate
from earl_jax.paper.artefact import Row, column
from earl_jax.report.style import (
    AXES,
    draw_band,
    legend_below,
    legend_entries,
    new_figure,
    reach,
    step_axis,
    task_title,
)
from earl_jax.report.tables import steps_text

PLOT_STYLES = {True: ("#D55E00", "o-"), False: ("#0072B2", "s--")}
"""Colour and line of each TD update by `timeout_bootstrap`."""


def draw(points: Sequence[Row], curves: Sequence[Row], updates: Mapping[bool, str]) -> Any:
    """Return a figure with a row per task: learning curves of each TD update by horizon, then final returns.

    Args:
        points: rows of env, timeout_bootstrap, train_horizon, return, low, high: the final returns.
        curves: the same with step, for every evaluation.
        updates: the names of the updates.
    """
    envs = list(dict.fromkeys(row["env"] for row in points))
    figure, axes = new_figure(len(envs), len(updates) + 1, (4.6 * (len(updates) + 1), 3.7 * len(envs) + 0.4))
    horizons = sorted({row["train_horizon"] for row in curves})
    for env, line in zip(envs, axes, strict=True):
        for update, axis in zip(updates, line, strict=False):
            for horizon in horizons:
                part = _chosen(curves, env=env, timeout_bootstrap=update, train_horizon=horizon)
                draw_band(axis, column(part, "step"), _estimates(part), _colour(horizon, horizons))
            axis.set(title=f"{task_title(env)}, {updates[update]}", ylabel=AXES["deployed/return"])
            axis.sharey(line[0])
            axis.grid(alpha=0.3)
            step_axis(axis)
        _draw_final(line[-1], _chosen(points, env=env), updates)
    lines = {f"Reset every {steps_text(horizon)}": {"color": _colour(horizon, horizons)} for horizon in horizons}
    names = {name.capitalize(): handle for name, handle in legend_entries(axes[:1, -1]).items()}
    legend_below(figure, lines | names, -(-(len(horizons) + 2) // 2))
    return figure


def _chosen(rows: Sequence[Row], **values: Any) -> list[Row]:
    return [row for row in rows if values.items() <= row.items()]


def _estimates(rows: Sequence[Row]) -> Estimate:
    return Estimate(*(column(rows, name) for name in ("return", "low", "high")))


def _colour(horizon: int, horizons: Sequence[int]) -> Any:
    """Return the colour of a horizon, from the darkest of the shortest to the brightest of the longest."""
    from matplotlib import colormaps

    return colormaps["viridis"](0.92 * horizons.index(horizon) / max(len(horizons) - 1, 1))


def _draw_final(axis: Any, rows: Sequence[Row], updates: Mapping[bool, str]) -> None:
    """Draw a task's final returns, moved sideways a little so that the intervals of both updates can be seen."""
    for update, name in updates.items():
        part, (colour, style) = _chosen(rows, timeout_bootstrap=update), PLOT_STYLES[update]
        estimate, x = _estimates(part), column(part, "train_horizon") * (1.03 if update else 0.97)
        axis.errorbar(x, estimate.value, reach(estimate), fmt=style, color=colour, label=name, capsize=3, markersize=5)
    title = f"{task_title(rows[0]['env'])}, final"
    axis.set(title=title, xscale="log", xlabel="Steps between resets", ylabel="Final return")
    ticks = sorted({row["train_horizon"] for row in rows})
    axis.set_xticks(ticks, [steps_text(horizon) for horizon in ticks])
    axis.set_xticks([], minor=True)
    axis.grid(alpha=0.3)
