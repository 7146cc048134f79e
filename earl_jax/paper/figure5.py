"""Figure 5 of the paper: final policies on tabletop from the usual start and from starts all over the table.

Source: Sharma et al. 2022, figure 5.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from earl_jax import assets
from earl_jax.metrics.robustness import relative_drop
from earl_jax.metrics.statistics import Estimate, mean_of
from earl_jax.paper.verdicts import FEW, FEW_SEEDS, bracketed
from earl_jax.report.style import COLOURS, canvas, colours, ordered, save
from earl_jax.report.tables import grid, write

COLUMNS = ("algo", "seed", "success_initial", "success_uniform")
TEXT = (
    "Success of final policies from the task's own start and from starts uniform over the workspace; mean over seeds [95 % "
    "bootstrap interval]. Drop: 1 minus uniform over initial, of the means over seeds."
)
RULE = (
    "Verdict: `within` where the published drop lies in our interval, `larger` where our whole interval lies above it, `smaller` "
    "where below; `-` where nothing is published, a method never succeeds from its own start, or one seed has no interval."
)


def write_figure5(rows: Sequence[Mapping[str, Any]], out: Path) -> list[Path]:
    """Write figure 5 from rows of algo, seed, success_initial, success_uniform and return the files: csvs, md, png.

    Raises:
        ValueError: there are no rows, one lacks a column, or matplotlib is not installed.
    """
    found = figure_rows(rows)
    picture = _draw(found)
    out.mkdir(parents=True, exist_ok=True)
    paths = [out / "figure5.csv", out / "figure5_seeds.csv", out / "figure5.md"]
    write(found, paths[0])
    write([{name: row[name] for name in COLUMNS} for row in rows], paths[1])
    paths[2].write_text(_markdown(found))
    return [*paths, save(picture, out / "figure5.png")]


def figure_rows(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return one row a method, in the paper's order: successes and drop with intervals, published drop, verdict."""
    if not rows:
        raise ValueError("figure 5 needs at least one row")
    for row in rows:
        if any(name not in row for name in COLUMNS):
            raise ValueError(f"a row of figure 5 has {', '.join(COLUMNS)}, not {', '.join(row)}")
    return [_row(rows, algo) for algo in ordered((row["algo"] for row in rows), COLOURS)]


def _row(rows: Sequence[Mapping[str, Any]], algo: str) -> dict[str, Any]:
    initial, uniform = (np.array([float(row[name]) for row in rows if row["algo"] == algo]) for name in COLUMNS[2:])
    drop, known = relative_drop(initial, uniform), _published(algo)
    parts = {"initial": mean_of(initial), "uniform": mean_of(uniform), "drop": drop}
    numbers = {
        name + suffix: number
        for name, estimate in parts.items()
        for suffix, number in zip(("", "_low", "_high"), estimate, strict=True)
    }
    return {"algo": algo, "seeds": len(initial), **numbers, "published_drop": known, "verdict": verdict(drop, known)}


def _published(algo: str) -> float | None:
    row = assets.published_row("figure5", algo=algo)
    return float(row["drop_percent"]) / 100 if row else None


def verdict(drop: Estimate, published: float | None) -> str:
    """Return how our `drop` lies beside the `published` one: within, larger, smaller, or `-`."""
    if published is None or not math.isfinite(drop.low):
        return "-"
    return "larger" if drop.low > published else "smaller" if drop.high < published else "within"


def _estimate(row: Mapping[str, Any], name: str) -> Estimate:
    return Estimate(row[name], row[f"{name}_low"], row[f"{name}_high"])


def _percent(share: float | None) -> str:
    return "-" if share is None or not math.isfinite(share) else f"{100 * share:.1f} %"


def _markdown(found: Sequence[dict[str, Any]]) -> str:
    lines = [
        [
            row["algo"], row["seeds"], bracketed(_estimate(row, "initial"), 3), bracketed(_estimate(row, "uniform"), 3),
            bracketed(_estimate(row, "drop"), 1, 100), _percent(row["published_drop"]), row["verdict"],
        ]
        for row in found
    ]  # fmt: skip
    header = ["method", "seeds", "from s0", "from uniform starts", "drop, %", "published drop", "verdict"]
    parts = ["# Figure 5: robustness to the start", TEXT, grid(header, lines), RULE]
    missing = [row["algo"] for row in assets.published("figure5") if row["algo"] not in {one["algo"] for one in found}]
    if missing:
        parts.append(f"Published, but not run: {', '.join(missing)}.")
    if any(row["seeds"] < FEW for row in found):
        parts.append(FEW_SEEDS)
    return "\n\n".join(parts) + "\n"


def _draw(found: Sequence[dict[str, Any]]) -> Any:
    """Return a figure with two bars a method, and the drops above them."""
    figure, axes = canvas(1, 1, (max(1.7 * len(found) + 1.5, 5.2), 4.4))
    axis, palette = axes[0, 0], colours(row["algo"] for row in found)
    for place, row in enumerate(found):
        for offset, name, look in ((-0.2, "initial", {}), (0.2, "uniform", {"alpha": 0.45, "hatch": "//"})):
            one = _estimate(row, name)
            reach = [[max(one.value - one.low, 0)], [max(one.high - one.value, 0)]]
            axis.bar(place + offset, one.value, 0.36, color=palette[row["algo"]], **look)
            for colour, width in (("white", 2.6), ("black", 1.2)):
                axis.errorbar(place + offset, one.value, reach, fmt="none", color=colour, capsize=3, linewidth=width)
        drop, known = _percent(row["drop"]), _percent(row["published_drop"])
        axis.text(place, 1.06, f"drop {drop}\npublished {known}", ha="center", va="bottom", fontsize="small")
    axis.set_xticks(range(len(found)), [row["algo"] for row in found])
    axis.set(ylim=(0, 1.25), xlim=(-0.6, len(found) - 0.4), ylabel="success", yticks=np.linspace(0, 1, 6))
    axis.grid(axis="y", alpha=0.3)
    axis.set_axisbelow(True)
    _legend(figure)
    return figure


def _legend(figure: Any) -> None:
    from matplotlib.patches import Patch

    usual = Patch(color="0.4", label="from the published start")
    uniform = Patch(facecolor="0.4", alpha=0.45, hatch="//", label="from uniform starts")
    figure.legend(handles=[usual, uniform], loc="outside lower center", ncols=2, frameon=False)
