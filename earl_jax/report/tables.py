"""The paper's two tables made from run folders, beside the published scores."""

import csv
import math
import re
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from earl_jax.errors import InputError
from earl_jax.metrics.comparison import mean_interval
from earl_jax.metrics.continuing import diverged_text
from earl_jax.metrics.crossings import crossing
from earl_jax.metrics.statistics import Estimate, stderr
from earl_jax.report.life_columns import life_headings, life_texts, life_values
from earl_jax.report.published import LEVELS, published_beside
from earl_jax.report.runs import Curves, labels, options_text, read_all

WINDOW = 10
"""Evaluations in the trailing mean of drawn curves."""
HEADER = (
    "env",
    "algo",
    "seeds",
    "steps",
    "deployed, mean [95 %]",
    "seeds over 0.5",
    "published",
    "continuing",
    "published",
    "to 0.5 [95 %]",
    "to 0.9 [95 %]",
    "steps/reward",
)
CONVERGED = 0.25
"""Share of a run, at its end, over which the converged reward rate is measured."""


def tabulate(folders: Sequence[Path], last: int = 1) -> list[dict[str, Any]]:
    """Return one row per method: deployed and continuing scores over seeds, crossings, and the published scores.

    Args:
        folders: run folders; seeds of the same task, method and options are pooled.
        last: evaluations averaged at the end of a run; the paper's table 1 uses 1.

    Raises:
        ValueError: `last` is below 1, or a folder cannot be read.
    """
    if last < 1:
        raise InputError(f"last must be at least 1, not {last}")
    runs = read_all(folders)
    return [row_of(curves, last, name) for curves, name in zip(runs, labels(runs), strict=True)]


def tabulate_metric(folders: Sequence[Path], metric: str, last: int = 1) -> list[dict[str, Any]]:
    """Return one row per method with the column `metric` of metrics.csv, averaged over the last evaluations.

    Raises:
        ValueError: as `tabulate`, or a run has no such column; the message names those that it has.
    """
    if last < 1:
        raise InputError(f"last must be at least 1, not {last}")
    runs = read_all(folders)
    return [_metric_row(curves, metric, last, name) for curves, name in zip(runs, labels(runs), strict=True)]


def _metric_row(curves: Curves, metric: str, last: int, name: str) -> dict[str, Any]:
    interval = mean_interval(curves.metrics[metric][:, -last:].mean(axis=1))
    return {
        "env": curves.config.env, "algo": name, "options": options_text(curves.options), "seeds": curves.seeds,
        "steps": int(curves.steps[-1]), "metric": metric, "mean": interval.value, "low": interval.low, "high": interval.high,
    }  # fmt: skip


def row_of(curves: Curves, last: int, name: str) -> dict[str, Any]:
    """Return the row of one method under `name`, as `tabulate` describes it."""
    scores = curves.metrics[curves.deployed_metric]
    deployed, continuing = scores[:, -last:].mean(axis=1), curves.metrics["continuing/reward"][:, -1]
    interval, rates = mean_interval(deployed), curves.deployed_metric == "deployed/success"
    return {
        "env": curves.config.env,
        "algo": name,
        "options": options_text(curves.options),
        "seeds": len(deployed),
        "diverged": curves.diverged,
        "steps": int(curves.steps[-1]),
        "deployed": interval.value,
        "deployed_stderr": float(stderr(deployed)),
        "deployed_low": interval.low,
        "deployed_high": interval.high,
        "seeds_above_half": float((deployed > 0.5).mean()) if rates else None,
        "published_deployed": _published("table1", curves),
        "continuing": float(continuing.mean()),
        "continuing_stderr": float(stderr(continuing)),
        "published_continuing": _published("table2", curves),
        **life_values(curves.metrics, last),
        **_crossings(curves),
        "steps_per_reward": steps_per_reward(curves) if rates else None,
    }


def _crossings(curves: Curves) -> dict[str, float | None]:
    """Return `steps_to_LEVEL` of both levels with the ends of its interval; None for what was not reached."""
    row: dict[str, float | None] = {}
    for level in LEVELS:
        names = (f"steps_to_{level}", f"steps_to_{level}_low", f"steps_to_{level}_high")
        row |= dict.fromkeys(names)
        if curves.deployed_metric == "deployed/success":
            estimate = crossing(curves.steps, curves.metrics[curves.deployed_metric], level)
            row |= {
                name: None if math.isnan(value) else int(value) for name, value in zip(names, estimate, strict=True)
            }
    return row


def trailing(curve: np.ndarray, window: int = WINDOW) -> np.ndarray:
    """Return the mean of the last `window` evaluations, or of all so far if fewer, at each evaluation of `curve [..., E]`."""
    ends = range(1, curve.shape[-1] + 1)
    return np.stack([curve[..., max(0, end - window) : end].mean(axis=-1) for end in ends], axis=-1)


def steps_per_reward(curves: Curves) -> float | None:
    """Return steps per +1 of task reward in the last quarter of the run, the median over seeds that earn there."""
    recent = curves.metrics["continuing/recent"]
    rate = recent[:, -max(1, round(CONVERGED * recent.shape[1])) :].mean(axis=1)
    return float(np.median(1 / rate[rate > 1e-3])) if (rate > 1e-3).any() else None


def _published(table: str, curves: Curves) -> str | None:
    score = published_beside(table, curves)
    return f"{score.mean} ({score.stderr})" if score else None


def markdown_table(header: Sequence[str], lines: Sequence[Sequence[Any]]) -> str:
    """Return a markdown table."""
    rows = ["| " + " | ".join(map(str, line)) + " |" for line in (header, *lines)]
    return "\n".join([rows[0], "|" + " --- |" * len(header), *rows[1:]])


def latex_table(header: Sequence[str], lines: Sequence[Sequence[Any]]) -> str:
    """Return a LaTeX `tabular` for the package booktabs."""
    rows = [" & ".join(map(_latex_text, line)) + r" \\" for line in (header, *lines)]
    rows = [r"\begin{tabular}{" + "l" * len(header) + "}", r"\toprule", rows[0], r"\midrule", *rows[1:]]
    return "\n".join([*rows, r"\bottomrule", r"\end{tabular}"])


def _latex_text(value: Any) -> str:
    return re.sub(r"([%&_#$])", r"\\\1", str(value)).replace("−", "$-$")


def file_table(path: Path, header: Sequence[str], lines: Sequence[Sequence[Any]], notes: str) -> str:
    """Return the text of the file `path`: a LaTeX table with `notes` as comments (.tex), or a markdown one above them."""
    if path.suffix == ".tex":
        lines_of_notes = [line for note in notes.splitlines() for line in textwrap.wrap(note, 100)]
        comments = "\n".join(f"% {line}" for line in lines_of_notes)
        return f"{comments}\n{latex_table(header, lines)}\n"
    return f"{markdown_table(header, lines)}\n\n{notes}\n"


def markdown(rows: list[dict[str, Any]]) -> str:
    """Return `rows` as a markdown table: means with intervals, published scores beside them."""
    return "\n".join([markdown_table(header_of(rows), lines_of(rows)), "", *notes_of(rows)])


def header_of(rows: list[dict[str, Any]]) -> Sequence[str]:
    """Return the header of rows of `tabulate` or of `tabulate_metric`."""
    if "metric" in rows[0]:
        return ("env", "algo", "seeds", "steps", f"{rows[0]['metric']}, mean [95 %]")
    return (*HEADER, *life_headings(rows))


def lines_of(rows: list[dict[str, Any]]) -> list[list[Any]]:
    """Return the cells of rows of `tabulate` or of `tabulate_metric`, as text."""
    if "metric" not in rows[0]:
        return _lines(rows)
    return [
        [
            row["env"],
            row["algo"],
            row["seeds"],
            f"{row['steps']:,}",
            _interval_of_any(row["mean"], row["low"], row["high"]),
        ]
        for row in rows
    ]


def _interval_of_any(value: float, low: float, high: float) -> str:
    """Return `value [low, high]` of a number of any size."""
    return f"{value:.4g}" + ("" if math.isnan(low) else f" [{low:.4g}, {high:.4g}]")


def _lines(rows: list[dict[str, Any]]) -> list[list[Any]]:
    headings = life_headings(rows)
    return [
        [
            row["env"], row["algo"], f"{row['seeds']}{diverged_text(row['diverged'], row['seeds'])}", f"{row['steps']:,}",
            interval_text(row["deployed"], row["deployed_low"], row["deployed_high"]),
            "-" if row["seeds_above_half"] is None else f"{row['seeds_above_half']:.0%}",
            row["published_deployed"] or "-", f"{row['continuing']:.5f} ({row['continuing_stderr']:.5f})",
            row["published_continuing"] or "-", *(_reached(row, level) for level in LEVELS),
            "-" if row["steps_per_reward"] is None else f"{row['steps_per_reward']:.1f}",
            *life_texts(row, headings),
        ]
        for row in rows
    ]  # fmt: skip


def notes_of(rows: list[dict[str, Any]]) -> list[str]:
    """Return a line for each of `rows` with the options of its runs."""
    return [f"{row['algo']}: {row['options']}" for row in rows]


def _reached(row: dict[str, Any], level: float) -> str:
    names = (f"steps_to_{level}", f"steps_to_{level}_low", f"steps_to_{level}_high")
    return step_interval(Estimate(*(math.nan if row[name] is None else row[name] for name in names)))


def interval_text(value: float, low: float, high: float) -> str:
    """Return `value [low, high]` with three digits, without the interval if it is nan."""
    return f"{value:.3f}" + ("" if math.isnan(low) else f" [{low:.3f}, {high:.3f}]")


def seeds_text(count: int) -> str:
    """Return a number of seeds in words, such as `1 seed` or `5 seeds`."""
    return f"{count} seed{'s' * (count != 1)}"


def millions(step: float | None) -> str:
    """Return a number of steps in millions, such as `2.50M`, and `-` for None and nan."""
    return "-" if step is None or math.isnan(step) else f"{step / 1e6:.2f}M"


def step_interval(estimate: Estimate) -> str:
    """Return a crossing with its interval in millions of steps; `-` stands for an end that was not reached."""
    if all(map(math.isnan, estimate)):
        return "-"
    return f"{millions(estimate.value)} [{millions(estimate.low)}, {millions(estimate.high)}]"


def write(rows: list[dict[str, Any]], path: Path) -> None:
    """Write rows to `path`: rows of `tabulate` as markdown (.md) or LaTeX (.tex), or any rows as csv (.csv).

    Raises:
        ValueError: `path` has another suffix.
    """
    if path.suffix in (".md", ".tex"):
        path.write_text(file_table(path, header_of(rows), lines_of(rows), "\n".join(notes_of(rows))))
    elif path.suffix == ".csv":
        with path.open("w", newline="") as handle:
            writer = csv.DictWriter(handle, rows[0], lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
    else:
        raise InputError(f"{path}: tables are written as .md, .tex or .csv")
