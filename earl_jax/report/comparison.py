"""Comparisons of runs with each other and with the published scores, as rows, tables and a figure."""

import base64
import html
import io
import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from earl_jax.errors import InputError
from earl_jax.metrics.comparison import (
    Comparison,
    Sample,
    detectable_difference,
    holm,
    mean_interval,
    permutation,
    welch,
)
from earl_jax.metrics.comparison import verdict as verdict_of
from earl_jax.metrics.statistics import Estimate
from earl_jax.report.published import RECONSTRUCTED, published_score, published_steps, share_text
from earl_jax.report.runs import MethodRuns, read_methods
from earl_jax.report.scores import recent_scores
from earl_jax.report.style import PICTURES, new_figure, reach, save
from earl_jax.report.tables import (
    file_table,
    html_table,
    interval_text,
    millions,
    number_text,
    seeds_text,
    shown_table,
    wrapped,
    write,
)

Row = dict[str, Any]
UNTESTED = dict.fromkeys(("difference", "low", "high", "p", "detectable"), math.nan)
OTHER_TASK = "not compared: the task is our reconstruction"
TABLES = (".md", ".tex", ".csv", ".html")
RULE = (
    "Scores are means over the evaluations of the last 100,000 steps, two runs at the last step that both have. Intervals of "
    "95 %: Student's for a mean, Welch's for a difference. p: the permutation test between runs, Welch's test against the "
    "paper's five seeds; adjusted by Holm over this table. Detectable: the difference that the test would find with a "
    "probability of 80 %."
)
PAGE = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; style-src 'unsafe-inline'; img-src data:">
<title>Comparison of runs</title>
<style>
body {{ font: 15px/1.5 sans-serif; margin: 2em; }} img {{ max-width: 100%; }} main {{ overflow-x: auto; }}
td, th {{ padding: 4px 10px; border-bottom: 1px solid #ccc; text-align: left; }}
</style>
<h1>Comparison of runs</h1>
<main>{picture}
{table}</main>
<p>{rule}</p>
</html>
"""
HEADER = (
    "task", "first", "second", "steps", "first, mean [95 %]", "second, mean", "difference [95 %]", "p", "adjusted p",
    "verdict", "detectable",
)  # fmt: skip


def compare(
    folders: Sequence[Path], against: Literal["runs", "published"] = "runs", metric: str | None = None
) -> list[Row]:
    """Return a row for each pair of methods on a task, or for each method beside its published score.

    Runs of the same task, method and options are pooled. Runs that are shorter than published are not compared; their
    verdict says so. `metric` is a column of metrics.csv, such as `deployed/success_wide`; None is the deployed score,
    the only one that the paper's tables have.

    Raises:
        ValueError: a folder is no run, it has no such metric, or there is nothing to compare.
    """
    if metric and against == "published":
        raise InputError("the published scores are those of the deployed metric: leave out --metric")
    groups = read_methods(folders)
    rows = published_rows(groups) if against == "published" else _pair_rows(groups, metric)
    if not rows:
        choices = "two methods on one task, or --against published" if against == "runs" else "tasks of the paper"
        raise InputError(f"there is nothing to compare; compare needs runs of {choices}")
    return with_verdicts(rows)


def with_verdicts(rows: list[Row]) -> list[Row]:
    """Return `rows` with p adjusted by Holm over all of them, and with the verdict of those that have none yet."""
    for row, adjusted in zip(rows, holm([row["p"] for row in rows]), strict=True):
        row["p_holm"] = float(adjusted)
        row["verdict"] = row["verdict"] or verdict_of(row["difference"], row["p_holm"])
    return rows


def _pair_rows(groups: Sequence[MethodRuns], metric: str | None) -> list[Row]:
    pairs = [(a, b) for a, b in itertools.combinations(groups, 2) if a.env == b.env]
    return [pair_row(first, second, metric) for first, second in pairs]


def pair_row(first: MethodRuns, second: MethodRuns, metric: str | None = None) -> Row:
    """Return the comparison of two methods on a task at the last step that both have, without an adjusted p.

    Raises:
        ValueError: one is scored by success and the other by return.
    """
    if metric is None and first.curves.deployed_metric != second.curves.deployed_metric:
        raise InputError(f"{first.label} and {second.label} on {first.env} have different metrics; compare them apart")
    step = int(min(first.curves.steps[-1], second.curves.steps[-1]))
    scores, others = (recent_scores(runs.curves, step, metric) for runs in (first, second))
    return _row(first, step, scores, second.label, Sample.of(others), permutation(scores, others))


def published_rows(groups: Sequence[MethodRuns]) -> list[Row]:
    """Return the comparison of each of `groups` with its published score, if it has one, without an adjusted p."""
    rows = []
    for group in groups:
        score = published_score("table1", group.env, group.algo) if group.curves.comparable else None
        sample, length = score and score.sample, (published_steps(group.env) or (0, 0))[0]
        if not score or not sample:
            continue
        step = int(group.curves.steps[-1])
        scores = recent_scores(group.curves, step)
        row = _row(group, step, scores, f"published {score.text}", sample, welch(Sample.of(scores), sample))
        if group.env in RECONSTRUCTED:
            row |= UNTESTED | {"second": "published", "other_mean": math.nan, "verdict": OTHER_TASK}
        elif step < length:
            row |= UNTESTED | {"verdict": f"not compared at {share_text(step, length)} of the published steps"}
        rows.append(row)
    return rows


def _row(first: MethodRuns, step: int, scores: np.ndarray, name: str, other: Sample, result: Comparison) -> Row:
    own = mean_interval(scores)
    return {
        "env": first.env, "first": first.label, "second": name, "steps": step, "seeds": len(scores), "other_seeds": other.seeds,
        "mean": own.value, "mean_low": own.low, "mean_high": own.high, "other_mean": other.mean,
        **comparison_columns(scores, other, result),
    }  # fmt: skip


def comparison_columns(scores: np.ndarray, other: Sample, result: Comparison, prefix: str = "") -> Row:
    """Return the columns of `result`, the test of `scores [N]` against `other`, before `with_verdicts`.

    The names of the ends of its interval start with `prefix`.
    """
    return {
        "difference": result.difference,
        f"{prefix}low": result.low,
        f"{prefix}high": result.high,
        "p": result.p,
        "verdict": "",
        "detectable": detectable_difference(Sample.of(scores), other),
    }


def table_text(rows: Sequence[Row], width: int | None = None) -> str:
    """Return the rows of `compare` as a table with the rule below it, markdown or for a terminal of `width` columns."""
    return f"{shown_table(HEADER, cells(rows), width)}\n\n{wrapped(RULE, width)}"


def write_comparison(rows: Sequence[Row], path: Path) -> Path:
    """Write the rows of `compare` to `path`, and return it.

    It is a table (.md, .tex, .csv), a figure (.png, .pdf, .svg), or a page of both that loads nothing else (.html).

    Raises:
        ValueError: `path` has another suffix, or matplotlib is not installed.
    """
    if path.suffix not in TABLES + PICTURES:
        raise InputError(f"{path}: comparisons are written as {', '.join(TABLES + PICTURES)}")
    if path.suffix in PICTURES:
        return save(_draw(rows), path)
    if path.suffix == ".html":
        path.write_text(_page(rows))
    elif path.suffix == ".csv":
        write(list(rows), path)
    else:
        path.write_text(file_table(path, HEADER, cells(rows), RULE))
    return path


def _page(rows: Sequence[Row]) -> str:
    """Return an HTML page of the table, with the figure above it if a difference has an interval."""
    picture = ""
    if not all(math.isnan(row["low"]) for row in rows):
        drawing = io.BytesIO()
        _draw(rows).savefig(drawing, format="svg")
        data = base64.b64encode(drawing.getvalue()).decode()
        picture = f'<img src="data:image/svg+xml;base64,{data}" alt="differences of means with 95 % intervals">'
    return PAGE.format(picture=picture, table=html_table(HEADER, cells(rows)), rule=html.escape(RULE))


def cells(rows: Sequence[Row]) -> list[list[str]]:
    """Return the texts of `rows` under `HEADER`."""
    return [
        [
            row["env"], f"{row['first']}, {seeds_text(row['seeds'])}", f"{row['second']}, {seeds_text(row['other_seeds'])}",
            millions(row["steps"]), interval_text(row["mean"], row["mean_low"], row["mean_high"], ".3g"),
            number_text(row["other_mean"]), interval_text(row["difference"], row["low"], row["high"], ".3g"),
            number_text(row["p"]), number_text(row["p_holm"]), row["verdict"], number_text(row["detectable"]),
        ]
        for row in rows
    ]  # fmt: skip


def _draw(rows: Sequence[Row]) -> Any:
    """Return a figure with the difference and interval of each row, a panel for each task."""
    rows = [row for row in rows if not math.isnan(row["low"])]
    if not rows:
        raise InputError("there is no difference with an interval to draw; runs need two seeds and the published steps")
    envs = list(dict.fromkeys(row["env"] for row in rows))
    figure, axes = new_figure(1, len(envs), (5.4 * len(envs), 1.2 + 0.4 * len(rows)))
    for env, axis in zip(envs, axes[0], strict=True):
        chosen = [row for row in rows if row["env"] == env]
        for position, row in enumerate(chosen):
            colour = "C0" if row["verdict"] in ("above", "below") else "0.5"
            interval = reach(Estimate(row["difference"], row["low"], row["high"]))
            axis.errorbar(row["difference"], position, xerr=interval, fmt="o", color=colour, capsize=3)
        axis.set_yticks(range(len(chosen)), [f"{row['first']} − {row['second']}" for row in chosen], fontsize="small")
        axis.axvline(0.0, color="black", linewidth=0.8)
        axis.set(title=env, xlabel="difference of means, 95 % interval", ylim=(len(chosen) - 0.5, -0.5))
    return figure
