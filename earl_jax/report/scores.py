"""The scores of runs: those of their seeds, crossings, and the row of a method that tables show."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from earl_jax.errors import InputError
from earl_jax.metrics import crossings
from earl_jax.metrics.comparison import mean_interval
from earl_jax.metrics.deployed import WIDE
from earl_jax.metrics.phase_stats import ALIVE, BACK, FORWARD, STILL
from earl_jax.metrics.scores import CONTINUING, SUCCESS, Window, final_scores, score_interval
from earl_jax.metrics.statistics import Estimate, stderr
from earl_jax.report.published import published_beside, released_beside
from earl_jax.report.runs import Curves, options_text, spacing

LEVELS = (0.5, 0.9)
"""Success rates for which reports give the first step that reaches them."""
SMOOTH = 10
"""Evaluations in the trailing mean of drawn curves."""
MEANS = {"forward_success": FORWARD, "back_success": BACK, "alive": ALIVE, "still_steps": STILL}
"""By the name of a row's value: the metric of which it is the mean over seeds."""


def seed_scores(curves: Curves, metric: str | None = None) -> np.ndarray:
    """Return the score [N] of each seed: the mean over the evaluations of its window, by default of the deployed `metric`.

    Raises:
        ValueError: the run has no such metric, or it has no value at some of these evaluations.
    """
    values = curves.metrics[metric or curves.deployed_metric]
    if metric and not np.isfinite(values[:, -curves.window.count(curves.steps) :]).all():
        raise InputError(f"{metric} of {curves.label or curves.algo} has no value at some evaluations, so no score")
    return final_scores(curves.steps, values, curves.window)


def require_curve(curves: Curves, metric: str | None) -> None:
    """Raise an InputError if a run has no `metric`, by default the deployed one, or no evaluation with values of all seeds."""
    name = metric or curves.deployed_metric
    if not np.isfinite(curves.metrics[name]).all(axis=0).any():
        raise InputError(f"{curves.algo} has no evaluation at which every seed has a value of {name}")


def over_same_steps(runs: Sequence[Curves], step: float = math.inf) -> list[Curves]:
    """Return `runs` up to `step`, with the window that scores all of them over as many steps: the longest of theirs.

    Raises:
        ValueError: a run has no evaluation up to `step`.
    """
    runs = [run.until(step) for run in runs]
    span = max(run.length - int(run.steps[-run.window.count(run.steps)]) for run in runs)
    window = Window(steps=span + min(spacing(run.steps) for run in runs))
    return [run._replace(window=window) for run in runs]


def interval_of(curves: Curves, scores: np.ndarray, metric: str | None = None) -> Estimate:
    """Return the `score_interval` of `scores [N]` or curves [N, E] of a run; `metric` is by default the deployed one."""
    return score_interval(scores, metric or curves.deployed_metric, curves.deployed_metric)


def trailing(curve: np.ndarray, window: int = SMOOTH) -> np.ndarray:
    """Return the mean of the last `window` evaluations, or of all so far if fewer, at each evaluation of `curve [..., E]`."""
    window = min(window, curve.shape[-1])
    starts = [curve[..., :end].mean(axis=-1, keepdims=True) for end in range(1, window)]
    return np.concatenate([*starts, np.lib.stride_tricks.sliding_window_view(curve, window, -1).mean(axis=-1)], axis=-1)


def in_as_many_steps(smooth: int, curves: Curves, other: Curves) -> int:
    """Return the number of evaluations of `other` in as many steps as `smooth` evaluations of `curves` take, at least one."""
    return max(1, round(smooth * spacing(curves.steps) / spacing(other.steps)))


def evenly_spaced(count: int, most: int) -> np.ndarray:
    """Return the indices of `count` evaluations, or of `most` of them if there are more, the first and the last included."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))


def level_crossings(curves: Curves) -> dict[float, Estimate]:
    """Return the first step at which the mean success reached each of `LEVELS`; nan for what was not reached."""
    if curves.deployed_metric != SUCCESS:
        return dict.fromkeys(LEVELS, Estimate(math.nan, math.nan, math.nan))
    return {level: crossings.crossing(curves.steps, curves.metrics[curves.deployed_metric], level) for level in LEVELS}


def crossings_beside(curves: Curves) -> dict[float, int]:
    """Return the first step at which the released runs beside a run reached each of `LEVELS` that they reached."""
    released = released_beside(curves)
    found = level_crossings(released) if released else {}
    return {level: int(step.value) for level, step in found.items() if not math.isnan(step.value)}


def row_of(curves: Curves) -> dict[str, Any]:
    """Return the row of one method under its label, as `tabulate` describes it."""
    deployed, continuing = seed_scores(curves), curves.metrics[CONTINUING][:, -1]
    above_half = float((deployed > 0.5 + crossings.ROUNDING).mean())
    interval, rates = interval_of(curves, deployed), curves.deployed_metric == SUCCESS
    table1, table2 = (published_beside(number, curves) for number in (1, 2))
    return {
        "env": curves.env,
        "algo": curves.label,
        "options": options_text(curves.options),
        "seeds": len(deployed),
        "diverged": curves.diverged,
        "steps": curves.length,
        "mean_over": curves.window.text,
        "deployed": interval.value,
        "deployed_stderr": float(stderr(deployed)),
        "deployed_low": interval.low,
        "deployed_high": interval.high,
        "seeds_above_half": above_half if rates and np.isfinite(deployed).all() else None,
        "published_deployed": table1 and table1.text,
        "continuing": float(continuing.mean()),
        "continuing_stderr": float(stderr(continuing)),
        "published_continuing": table2 and table2.text,
        **life_values(curves.metrics, curves.window.count(curves.steps)),
        **_crossing_columns(curves),
        "steps_per_reward": steps_per_reward(curves) if rates else None,
    }


def life_values(metrics: dict[str, np.ndarray], last: int) -> dict[str, float | None]:
    """Return the values of a row from `metrics [N, E]`, over the last `last` evaluations; None for a missing metric.

    `wide` is the mean over seeds with its 95 % interval; the others are means over seeds of what was measured of each.
    """
    wide = mean_interval(metrics[WIDE][:, -last:].mean(axis=1), True) if WIDE in metrics else Estimate(None, None, None)
    values: dict[str, float | None] = wide.columns("wide", "wide_")
    for name, metric in MEANS.items():
        measured = [seed[~np.isnan(seed)] for seed in metrics[metric][:, -last:]] if metric in metrics else []
        means = [seed.mean() for seed in measured if len(seed)]
        values[name] = float(np.mean(means)) if means else None
    return values


def _crossing_columns(curves: Curves) -> dict[str, int | None]:
    """Return `steps_to_LEVEL` of both levels with the ends of its interval; None for what was not reached."""
    columns = {}
    for level, estimate in level_crossings(curves).items():
        columns |= estimate.columns(f"steps_to_{level}", f"steps_to_{level}_")
    return {name: None if math.isnan(step) else int(step) for name, step in columns.items()}


def steps_per_reward(curves: Curves) -> float | None:
    """Return steps per +1 of task reward in the last quarter of the run, the median over seeds, infinite for those without.

    None if the median is infinite, or if the run has no such column.
    """
    if "continuing/recent" not in curves.metrics:
        return None
    recent = curves.metrics["continuing/recent"]
    rate = recent[:, -max(1, round(0.25 * recent.shape[1])) :].mean(axis=1)
    with np.errstate(divide="ignore"):
        steps = float(np.median(1 / np.maximum(rate, 0.0)))
    return steps if math.isfinite(steps) else None
