"""The picture of figure 2: learning curves by H_T for each TD update, and the final return by H_T."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from earl_jax.metrics.statistics import mean_of
from earl_jax.report.style import new_figure, step_axis, task_title

PLOT_STYLES = {True: ("#D55E00", "o-"), False: ("#0072B2", "s--")}
"""Colour and line of each TD update by `timeout_bootstrap`."""
COLOUR_MAP = "viridis"
"""The colours of the horizons, from the shortest to the longest."""


class HorizonScores(Protocol):
    """The final returns [seeds] with one horizon."""

    @property
    def horizon(self) -> int:
        """H_T."""
        ...

    @property
    def scores(self) -> np.ndarray:
        """One return for each seed."""
        ...


def draw(
    arms: Mapping[tuple[str, bool], Sequence[HorizonScores]],
    curves: Sequence[Mapping[str, Any]],
    updates: Mapping[bool, str],
) -> Any:
    """Return a figure with a row per task: learning curves of each TD update by horizon, then final returns.

    Args:
        arms: final returns by task and `timeout_bootstrap`, shortest horizon first.
        curves: rows of env, timeout_bootstrap, train_horizon, step, return, low, high.
        updates: the names of the updates.
    """
    envs = list(dict.fromkeys(env for env, _ in arms))
    figure, axes = new_figure(len(envs), len(updates) + 1, (4.6 * (len(updates) + 1), 3.7 * len(envs) + 0.4))
    horizons = sorted({row["train_horizon"] for row in curves})
    for env, line in zip(envs, axes, strict=True):
        for update, axis in zip(updates, line, strict=False):
            rows = [row for row in curves if (row["env"], row["timeout_bootstrap"]) == (env, update)]
            _draw_curves(axis, rows, horizons)
            axis.set(title=f"{task_title(env)}, {updates[update]}", ylabel="return")
            axis.sharey(line[0])
        for update, name in updates.items():
            _draw_arm(line[-1], arms[env, update], update, name)
        _format_final(line[-1], env, {point.horizon for update in updates for point in arms[env, update]})
    _add_legends(figure, axes, horizons)
    return figure


def _colour(horizon: int, horizons: Sequence[int]) -> Any:
    from matplotlib import colormaps

    return colormaps[COLOUR_MAP](0.92 * horizons.index(horizon) / max(len(horizons) - 1, 1))


def _draw_curves(axis: Any, rows: Sequence[Mapping[str, Any]], horizons: Sequence[int]) -> None:
    """Draw the mean return over training with its interval, a line for each horizon."""
    for horizon in horizons:
        part = [row for row in rows if row["train_horizon"] == horizon]
        steps, means, low, high = (np.array([row[key] for row in part]) for key in ("step", "return", "low", "high"))
        colour = _colour(horizon, horizons)
        axis.plot(steps, means, color=colour, linewidth=1.3)
        axis.fill_between(steps, low, high, color=colour, alpha=0.15, linewidth=0)
    step_axis(axis, "training steps")
    axis.grid(alpha=0.3)


def _format_final(axis: Any, env: str, horizons: Iterable[int]) -> None:
    axis.set(title=f"{task_title(env)}, final", xscale="log", xlabel="H_T, steps between resets", ylabel="final return")
    ticks = sorted(horizons)
    axis.set_xticks(ticks, [_horizon_text(horizon) for horizon in ticks])
    axis.set_xticks([], minor=True)
    axis.grid(alpha=0.3)


def _draw_arm(axis: Any, arm: Sequence[HorizonScores], update: bool, name: str) -> None:
    """Draw one update's final returns, moved sideways a little so that the intervals of both updates can be seen."""
    colour, line_style = PLOT_STYLES[update]
    estimates = [mean_of(point.scores) for point in arm]
    reach = [[max(part.value - part.low, 0), max(part.high - part.value, 0)] for part in estimates]
    axis.errorbar(
        [point.horizon * (1.03 if update else 0.97) for point in arm],
        [estimate.value for estimate in estimates],
        np.array(reach).reshape(-1, 2).T,
        fmt=line_style,
        color=colour,
        label=name,
        capsize=3,
        markersize=5,
    )


def _add_legends(figure: Any, axes: Any, horizons: Sequence[int]) -> None:
    from matplotlib.lines import Line2D

    handles = [Line2D([], [], color=_colour(horizon, horizons)) for horizon in horizons]
    names = [f"H_T {_horizon_text(horizon)}" for horizon in horizons]
    points, labels = axes[0, -1].get_legend_handles_labels()
    figure.legend(
        [*handles, *points], [*names, *labels], loc="outside lower center", ncols=len(names) + 2, frameon=False
    )


def _horizon_text(horizon: int) -> str:
    return f"{horizon // 1000}k" if horizon % 1000 == 0 else f"{horizon:,}"
