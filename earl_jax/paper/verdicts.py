"""Where a measured number lies beside a published one."""

import math
from decimal import Decimal

from earl_jax import assets
from earl_jax.metrics.statistics import Estimate

NORMAL = 1.96
FEW = 5
RULE = (
    "Published interval: mean ± 1.96 standard errors of five seeds, mean and standard error each taken half a unit of their "
    "last printed digit wider, because the table is rounded; `<0.001` means 0 to 0.001. A verdict says where our mean lies: "
    "within, above or below that interval; `-` where nothing is published or nothing was run."
)
FEW_SEEDS = "Intervals over fewer than five seeds are narrower than their name says."


def published(table: str, env: str, algo: str) -> tuple[str, str] | None:
    """Return the printed mean and standard error of a cell of `table1` or `table2`, or None where the paper has none."""
    row = assets.published_row(table, env=env, algo=algo)
    return (row["mean"], row["stderr"]) if row else None


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


def told(estimate: Estimate, above: str, below: str, neither: str) -> str:
    """Return `above` or `below` where the whole interval lies on that side of 0, else `neither`."""
    return above if estimate.low > 0 else below if estimate.high < 0 else neither


def bracketed(estimate: Estimate, digits: int, factor: float = 1.0) -> str:
    """Return an estimate for people, `value [low, high]`, each times `factor`; `-` stands for what cannot be told."""
    value, low, high = (f"{factor * number:.{digits}f}" if math.isfinite(number) else "-" for number in estimate)
    return f"{value} [{low}, {high}]" if low != "-" else value
