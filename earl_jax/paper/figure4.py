"""Figure 4 of the paper: final policies on tabletop from the usual start and from starts all over the table.

Source: Sharma et al. 2022, figure 4.
"""

import math
from collections.abc import Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from earl_jax import assets
from earl_jax.errors import InputError
from earl_jax.metrics.comparison import mean_interval
from earl_jax.metrics.statistics import Estimate, relative_drop
from earl_jax.paper.artefact import Artefact, Report, Row, column, runs_of
from earl_jax.report import style
from earl_jax.report.pooling import pooling_key
from earl_jax.report.tables import interval_text, markdown_table
from earl_jax.runs.folder import RunFolder
from earl_jax.training import evaluate

METHODS = ("fbrl", "vaprl", "oracle")
EPISODES = 100
FEW_SEEDS = "The interval of a drop, by the bootstrap, is too narrow with fewer than ten seeds."


def report(folders: Sequence[Path]) -> Report:
    """Return figure 4 from run folders, whose final policies are evaluated.

    Raises:
        ValueError: a folder holds no run with policies, runs of one method differ in their task or options, or matplotlib is
            not installed.
    """
    rows = []
    configs = {folder: RunFolder.open(folder).config for folder in folders}
    keys: dict[str, str] = {}
    for config in configs.values():
        key = pooling_key(config)
        if keys.setdefault(config.algo, key) != key:
            raise InputError(f"runs of {config.algo} differ in task or options; name runs that have the same")
    for folder, config in configs.items():
        successes = [evaluate(folder, EPISODES, starts=starts)["deployed/success"] for starts in ("initial", "uniform")]
        for seed, initial, uniform in zip(config.seeds, *(values.tolist() for values in successes), strict=True):
            rows.append({"algo": config.algo, "seed": seed, "success_initial": initial, "success_uniform": uniform})
    return report_of(rows)


def report_of(rows: list[Row]) -> Report:
    """Return figure 4 from a row per seed of algo, seed, success_initial, success_uniform."""
    by_method = style.grouped(rows, itemgetter("algo"))
    methods = [_row(algo, by_method[algo]) for algo in style.method_order(by_method)]
    return Report(_parts(methods), _draw(methods), {"": methods, "_seeds": rows})


def _row(algo: str, seeds: Sequence[Row]) -> Row:
    """Return a method's row: successes and drop with intervals, published drop, verdict."""
    initial, uniform = column(seeds, "success_initial"), column(seeds, "success_uniform")
    drop, published = relative_drop(initial, uniform), assets.published_row("figure4", algo=algo)
    published_drop = float(published["drop_percent"]) / 100 if published else None
    return {
        "algo": algo,
        "seeds": len(initial),
        **mean_interval(initial, rate=True).columns("initial", "initial_"),
        **mean_interval(uniform, rate=True).columns("uniform", "uniform_"),
        **drop.columns("drop", "drop_"),
        "published_drop": published_drop,
        "verdict": verdict(drop, published_drop),
    }


def verdict(drop: Estimate, published: float | None) -> str:
    """Return how our `drop` compares with the `published` one: within, larger, smaller, or `-`."""
    if published is None or not math.isfinite(drop.low):
        return "-"
    return "larger" if drop.low > published else "smaller" if drop.high < published else "within"


def _percent(share: float | None) -> str:
    return "-" if share is None or not math.isfinite(share) else f"{100 * share:.1f} %"


def _parts(methods: Sequence[Row]) -> dict[str, str]:
    lines = []
    for row in methods:
        successes = [interval_text(*Estimate.of_row(row, name)) for name in ("initial", "uniform")]
        drop = interval_text(*(100 * end for end in Estimate.of_row(row, "drop")), style=".1f")
        lines.append([row["algo"], row["seeds"], *successes, drop, _percent(row["published_drop"]), row["verdict"]])
    header = ["method", "seeds", "from s0", "from uniform starts", "drop, %", "published drop", "verdict"]
    missing = [name for row in assets.published("figure4") if (name := row["algo"]) not in {m["algo"] for m in methods}]
    return {
        "drops": markdown_table(header, lines),
        "missing": f"Published, but not run: {', '.join(missing)}." if missing else "",
        "few_seeds": FEW_SEEDS if any(row["seeds"] < 10 for row in methods) else "",
    }


def _draw(methods: Sequence[Row]) -> Any:
    """Return a figure with two bars per method, and the drops above them."""
    figure, axes = style.new_figure(1, 1, (max(1.7 * len(methods) + 1.5, 5.2), 4.4))
    from matplotlib.patches import Patch

    axis, palette = axes[0, 0], style.colours(row["algo"] for row in methods)
    for position, row in enumerate(methods):
        colour = palette[row["algo"]]
        for name, x, look in (("initial", -0.2, {}), ("uniform", 0.2, {"alpha": 0.45, "hatch": "//"})):
            _draw_bar(axis, position + x, Estimate.of_row(row, name), color=colour, **look)
        text = f"Drop {_percent(row['drop'])}\npublished {_percent(row['published_drop'])}"
        axis.text(position, 1.06, text, ha="center", va="bottom", fontsize="small")
    axis.set_xticks(range(len(methods)), [style.method_title(row["algo"]) for row in methods])
    limits = {"xlim": (-0.6, len(methods) - 0.4), "ylim": (0, 1.25)}
    axis.set(**limits, ylabel=style.AXES["deployed/success"], yticks=np.linspace(0, 1, 6))
    axis.grid(axis="y", alpha=0.3)
    axis.set_axisbelow(True)
    initial, uniform = Patch(color="0.4"), Patch(facecolor="0.4", alpha=0.45, hatch="//")
    style.legend_below(figure, {"From the published start": initial, "From uniform starts": uniform}, 2)
    return figure


def _draw_bar(axis: Any, x: float, estimate: Estimate, **bar_style: Any) -> None:
    """Draw a bar with its interval, black on a white outline."""
    axis.bar(x, estimate.value, 0.36, **bar_style)
    for colour, width in (("white", 2.6), ("black", 1.2)):
        axis.errorbar(x, estimate.value, style.reach(estimate), fmt="none", color=colour, capsize=3, linewidth=width)


FIGURE4 = Artefact("figure4", ("tabletop_organization",), runs_of(*METHODS), report)
