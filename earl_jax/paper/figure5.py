"""Figure 5 of the paper: final policies on tabletop from the usual start and from starts all over the table.

Source: Sharma et al. 2022, figure 5.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from earl_jax import assets
from earl_jax.errors import InputError
from earl_jax.metrics.statistics import Estimate, mean_of, relative_drop
from earl_jax.report.published import FEW, FEW_SEEDS, estimate_text
from earl_jax.report.style import colours, legend_below, method_order, new_figure, reach, save
from earl_jax.report.tables import markdown_table, write

COLUMNS = ("algo", "seed", "success_initial", "success_uniform")
DESCRIPTION = (
    "Success of final policies from the task's own start and from starts uniform over the workspace; mean over seeds "
    "[95 % bootstrap interval]. Drop: 1 minus uniform over initial, of the means over seeds."
)
RULES = (
    "Verdict: `within` if the published drop lies in our interval, `larger` if our whole interval lies above it, "
    "`smaller` if it lies below; `-` if nothing is published, if a method never succeeds from its own start, or if "
    "there is only one seed, which has no interval."
)


def write_figure5(rows: Sequence[Mapping[str, Any]], out: Path) -> list[Path]:
    """Write figure 5 from rows of algo, seed, success_initial, success_uniform and return the files: csvs, md, png.

    Raises:
        ValueError: there are no rows, one lacks a column, or matplotlib is not installed.
    """
    methods = figure_rows(rows)
    figure = _draw(methods)
    out.mkdir(parents=True, exist_ok=True)
    paths = [out / "figure5.csv", out / "figure5_seeds.csv", out / "figure5.md"]
    write(methods, paths[0])
    write([{name: row[name] for name in COLUMNS} for row in rows], paths[1])
    paths[2].write_text(_markdown(methods))
    return [*paths, save(figure, out / "figure5.png")]


def figure_rows(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return one row per method, in the paper's order: successes and drop with intervals, published drop, verdict.

    Raises:
        ValueError: there are no rows, or one lacks a column.
    """
    if not rows:
        raise InputError("figure 5 needs at least one row")
    for row in rows:
        if any(name not in row for name in COLUMNS):
            raise InputError(f"a row of figure 5 has {', '.join(COLUMNS)}, not {', '.join(row)}")
    return [_row(rows, algo) for algo in method_order(row["algo"] for row in rows)]


def _row(rows: Sequence[Mapping[str, Any]], algo: str) -> dict[str, Any]:
    of_method = [row for row in rows if row["algo"] == algo]
    initial, uniform = (np.array([float(row[name]) for row in of_method]) for name in COLUMNS[2:])
    drop, published = relative_drop(initial, uniform), _published_drop(algo)
    estimates = {"initial": mean_of(initial), "uniform": mean_of(uniform), "drop": drop}
    numbers = {
        name + suffix: number
        for name, estimate in estimates.items()
        for suffix, number in zip(("", "_low", "_high"), estimate, strict=True)
    }
    return {
        "algo": algo,
        "seeds": len(initial),
        **numbers,
        "published_drop": published,
        "verdict": verdict(drop, published),
    }


def _published_drop(algo: str) -> float | None:
    row = assets.published_row("figure5", algo=algo)
    return float(row["drop_percent"]) / 100 if row else None


def verdict(drop: Estimate, published: float | None) -> str:
    """Return how our `drop` compares with the `published` one: within, larger, smaller, or `-`."""
    if published is None or not math.isfinite(drop.low):
        return "-"
    return "larger" if drop.low > published else "smaller" if drop.high < published else "within"


def _estimate(row: Mapping[str, Any], name: str) -> Estimate:
    return Estimate(row[name], row[f"{name}_low"], row[f"{name}_high"])


def _percent(share: float | None) -> str:
    return "-" if share is None or not math.isfinite(share) else f"{100 * share:.1f} %"


def _markdown(methods: Sequence[dict[str, Any]]) -> str:
    lines = [
        [
            row["algo"],
            row["seeds"],
            estimate_text(_estimate(row, "initial"), 3),
            estimate_text(_estimate(row, "uniform"), 3),
            estimate_text(_estimate(row, "drop"), 1, 100),
            _percent(row["published_drop"]),
            row["verdict"],
        ]
        for row in methods
    ]
    header = ["method", "seeds", "from s0", "from uniform starts", "drop, %", "published drop", "verdict"]
    parts = ["# Figure 5: robustness to the start", DESCRIPTION, markdown_table(header, lines), RULES]
    present = {row["algo"] for row in methods}
    missing = [row["algo"] for row in assets.published("figure5") if row["algo"] not in present]
    if missing:
        parts.append(f"Published, but not run: {', '.join(missing)}.")
    if any(row["seeds"] < FEW for row in methods):
        parts.append(FEW_SEEDS)
    return "\n\n".join(parts) + "\n"


def _draw(methods: Sequence[dict[str, Any]]) -> Any:
    """Return a figure with two bars per method, and the drops above them."""
    figure, axes = new_figure(1, 1, (max(1.7 * len(methods) + 1.5, 5.2), 4.4))
    axis, palette = axes[0, 0], colours(row["algo"] for row in methods)
    for position, row in enumerate(methods):
        colour = palette[row["algo"]]
        _draw_bar(axis, position - 0.2, _estimate(row, "initial"), color=colour)
        _draw_bar(axis, position + 0.2, _estimate(row, "uniform"), color=colour, alpha=0.45, hatch="//")
        drop, published = _percent(row["drop"]), _percent(row["published_drop"])
        text = f"drop {drop}\npublished {published}"
        axis.text(position, 1.06, text, ha="center", va="bottom", fontsize="small")
    axis.set_xticks(range(len(methods)), [row["algo"] for row in methods])
    axis.set(ylim=(0, 1.25), xlim=(-0.6, len(methods) - 0.4), ylabel="success", yticks=np.linspace(0, 1, 6))
    axis.grid(axis="y", alpha=0.3)
    axis.set_axisbelow(True)
    _add_legend(figure)
    return figure


def _draw_bar(axis: Any, x: float, estimate: Estimate, **bar_style: Any) -> None:
    """Draw a bar with its interval, black on a white outline."""
    axis.bar(x, estimate.value, 0.36, **bar_style)
    for colour, width in (("white", 2.6), ("black", 1.2)):
        axis.errorbar(x, estimate.value, reach(estimate), fmt="none", color=colour, capsize=3, linewidth=width)


def _add_legend(figure: Any) -> None:
    from matplotlib.patches import Patch

    initial, uniform = Patch(color="0.4"), Patch(facecolor="0.4", alpha=0.45, hatch="//")
    legend_below(figure, {"from the published start": initial, "from uniform starts": uniform}, 2)
