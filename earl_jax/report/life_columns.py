"""The columns of a table that the paper's tables lack: success from wide starts, and what happens inside the life."""

import warnings
from typing import Any

import numpy as np

from earl_jax.metrics.comparison import mean_interval
from earl_jax.metrics.continuing import DIVERGED
from earl_jax.metrics.deployed import WIDE
from earl_jax.metrics.life import ALIVE, BACK, FORWARD, LIFE_METRICS, STILL

OPTIONAL_METRICS = frozenset({DIVERGED, WIDE, *LIFE_METRICS})
"""Metrics that some runs do not have."""
SHARES = frozenset({"deployed/success", WIDE, FORWARD, BACK, ALIVE})
"""Metrics that are shares, from 0 to 1."""
MEANS = {
    "forward_success": (FORWARD, "forward", 2),
    "back_success": (BACK, "back", 2),
    "alive": (ALIVE, "alive", 2),
    "still_steps": (STILL, "still", 0),
}
"""By the name of a row's value: the metric of which it is the mean over seeds, its heading, and digits after the point."""
WIDE_HEADING = "wide, mean [95 %]"


def life_values(metrics: dict[str, np.ndarray], last: int) -> dict[str, float | None]:
    """Return the values of a row from `metrics [N, E]`, over the last `last` evaluations; None for a missing metric.

    `wide` is the mean over seeds with Student's 95 % interval; the others are means of what was measured.
    """
    values: dict[str, float | None] = dict.fromkeys(("wide", "wide_low", "wide_high", *MEANS))
    if WIDE in metrics:
        interval = mean_interval(metrics[WIDE][:, -last:].mean(axis=1))
        values |= {"wide": interval.value, "wide_low": interval.low, "wide_high": interval.high}
    for name, (metric, _, _) in MEANS.items():
        if metric in metrics:
            values[name] = _mean(metrics[metric][:, -last:])
    return values


def _mean(values: np.ndarray) -> float | None:
    """Return the mean of the `values` that are not nan; None without any."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        mean = float(np.nanmean(values))
    return None if np.isnan(mean) else mean


def life_headings(rows: list[dict[str, Any]]) -> list[str]:
    """Return the headings of those columns that a row has a value for."""
    headings = [WIDE_HEADING] if any(row["wide"] is not None for row in rows) else []
    return headings + [heading for name, (_, heading, _) in MEANS.items() if any(row[name] is not None for row in rows)]


def life_texts(row: dict[str, Any], headings: list[str]) -> list[str]:
    """Return the texts of `row` under `headings`."""
    texts = {WIDE_HEADING: "-"}
    if row["wide"] is not None:
        interval = "" if np.isnan(row["wide_low"]) else f" [{row['wide_low']:.3f}, {row['wide_high']:.3f}]"
        texts[WIDE_HEADING] = f"{row['wide']:.3f}{interval}"
    for name, (_, heading, digits) in MEANS.items():
        texts[heading] = "-" if row[name] is None else f"{row[name]:,.{digits}f}"
    return [texts[heading] for heading in headings]
