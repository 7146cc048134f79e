"""Where a measured number lies beside a published one, and the estimates that are compared."""

import math
from decimal import Decimal
from typing import NamedTuple

import numpy as np

from earl_jax import assets
from earl_jax.metrics.statistics import RESAMPLES, bootstrap

NORMAL = 1.96
FEW = 5
RULE = (
    "Published interval: mean ± 1.96 standard errors of five seeds, mean and standard error each taken half a unit of their "
    "last printed digit wider, because the table is rounded; `<0.001` means 0 to 0.001. A verdict says where our mean lies: "
    "within, above or below that interval; `-` where nothing is published or nothing was run."
)
FEW_SEEDS = "Intervals over fewer than five seeds are narrower than their name says."


class Estimate(NamedTuple):
    """A number with its 95 % interval, which is nan to nan where there are too few seeds to tell."""

    value: float
    low: float
    high: float


def published(table: str, env: str, algo: str) -> tuple[str, str] | None:
    """Return the printed mean and standard error of a cell of `table1` or `table2`, or None where the paper has none."""
    for row in assets.published(table):
        if row["env"] == env and row["algo"] == algo:
            return row["mean"], row["stderr"]
    return None


def interval(mean: str, stderr: str) -> tuple[float, float] | None:
    """Return the published 95 % interval of a printed cell: mean ± 1.96 s.e., each half a unit of the last digit wider.

    `<x` is 0 to x; `-` has no interval.
    """
    if mean == "-":
        return None
    if mean.startswith("<"):
        return 0.0, float(mean[1:])
    half = 0.5 * 10.0 ** int(Decimal(mean).as_tuple().exponent)
    spread = half + NORMAL * (0.0 if stderr == "-" else float(stderr) + half)
    return float(mean) - spread, float(mean) + spread


def verdict(value: float | None, interval: tuple[float, float] | None) -> str:
    """Return where `value` lies: within (ends included), above or below the published `interval`; `-` without either."""
    if value is None or interval is None or not math.isfinite(value):
        return "-"
    return "below" if value < interval[0] else "above" if value > interval[1] else "within"


def mean_of(scores: np.ndarray) -> Estimate:
    """Return the mean of `scores [seeds]` with its bootstrap interval."""
    value = float(np.mean(scores))
    return Estimate(value, *bootstrap(scores, np.mean)) if len(scores) > 1 else Estimate(value, math.nan, math.nan)


def difference(one: np.ndarray, other: np.ndarray) -> Estimate:
    """Return mean(`one`) - mean(`other`) of independent seeds, [seeds] each, with its bootstrap interval."""
    value = float(np.mean(one) - np.mean(other))
    if min(len(one), len(other)) < 2:
        return Estimate(value, math.nan, math.nan)
    rng = np.random.default_rng(0)
    means = [
        np.asarray(part)[rng.integers(len(part), size=(RESAMPLES, len(part)))].mean(axis=1) for part in (one, other)
    ]
    return Estimate(value, *_middle(means[0] - means[1]))


def relative_drop(before: np.ndarray, after: np.ndarray) -> Estimate:
    """Return 1 - mean(`after`) / mean(`before`) of the same seeds, [seeds] each, with its bootstrap interval.

    Seeds are resampled in pairs; resamples without any success before say nothing and are left out. Nothing before: nan.
    """
    before, after = np.asarray(before, float), np.asarray(after, float)
    if not before.mean() > 0:
        return Estimate(math.nan, math.nan, math.nan)
    value = float(1 - after.mean() / before.mean())
    if len(before) < 2:
        return Estimate(value, math.nan, math.nan)
    picks = np.random.default_rng(0).integers(len(before), size=(RESAMPLES, len(before)))
    kept = picks[before[picks].mean(axis=1) > 0]
    return Estimate(value, *_middle(1 - after[kept].mean(axis=1) / before[kept].mean(axis=1)))


def told(estimate: Estimate, above: str, below: str, neither: str) -> str:
    """Return `above` or `below` where the whole interval lies on that side of 0, else `neither`."""
    return above if estimate.low > 0 else below if estimate.high < 0 else neither


def bracketed(estimate: Estimate, digits: int, factor: float = 1.0) -> str:
    """Return an estimate for people, `value [low, high]`, each times `factor`; `-` stands for what cannot be told."""
    value, low, high = (f"{factor * number:.{digits}f}" if math.isfinite(number) else "-" for number in estimate)
    return f"{value} [{low}, {high}]" if low != "-" else value


def _middle(resampled: np.ndarray) -> tuple[float, float]:
    low, high = np.quantile(resampled, [0.025, 0.975])
    return float(low), float(high)
