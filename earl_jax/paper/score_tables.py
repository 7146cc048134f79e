"""Tables 1 and 2 of the paper made from run folders, beside the published scores.

Source: Sharma et al. 2022, tables 1 and 2.
"""

import functools
from collections.abc import Mapping, Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any

from earl_jax.envs import PAPER_TASKS, make
from earl_jax.metrics.continuing import diverged_text
from earl_jax.metrics.statistics import Estimate
from earl_jax.options.values import counted
from earl_jax.paper.artefact import METHODS, Artefact, Report, Row, runs_of
from earl_jax.paper.claims import claims_text
from earl_jax.report import style
from earl_jax.report.comparison import compared_texts
from earl_jax.report.paper_rows import DESCRIPTIONS, HEADINGS, paper_rows, share_of_steps
from earl_jax.report.pooling import read_methods
from earl_jax.report.published import INTERVAL_RULE, PublishedScore, published_fault
from earl_jax.report.tables import error_text, markdown_table, millions
from earl_jax.runs.config import DEPLOYED

CHOSEN_RULE = (
    "Ours and published are means over the same steps and the same window. Chosen: settings that were chosen with a look at runs "
    "of the same tasks, which favours them."
)
TESTS = ("task", "method", "steps", "ours", "published", "difference [95 %]", "p", "adjusted p", "verdict", "chosen")
"""The columns of the table of tests."""
DIGITS = {"deployed/success": ".3f", "deployed/return": ".2f"}
LONGEST = 40
"""Largest number of letters of a label in the picture."""


def report(number: int, folders: Sequence[Path]) -> Report:
    """Return table `number` of the paper (1 or 2) from run folders. Errors as `read_methods` and `new_figure`."""
    runs = read_methods(folders)
    rows = paper_rows(number, runs)
    trained = [row for row in rows if row["seeds"] is not None]
    parts = {
        "heading": HEADINGS[number],
        "description": DESCRIPTIONS[number],
        "cells": _table_by_task(rows),
        "claims": claims_text(number, runs),
        "tests": _tests([row for row in rows if row["p"] is not None]),
        "rule": INTERVAL_RULE,
        "faults": _faults(number, trained),
        "runs": "\n".join(map(_run_note, trained)),
        "missing": _missing(rows),
    }
    metrics = {(curves.env, curves.label): curves.deployed_metric for curves in runs}
    return Report(parts, _draw(number, rows, metrics), {"": rows}, "tables")


def _table_by_task(rows: Sequence[Row]) -> str:
    """Return a markdown table of the scores, a line per method and a column per task."""
    envs = list(dict.fromkeys(row["env"] for row in rows))
    texts = {(row["label"], row["env"]): _comparison(row) for row in rows}
    algos = style.method_order(row["algo"] for row in rows)
    names = dict.fromkeys(row["label"] for algo in algos for row in rows if row["algo"] == algo)
    lines = [[name, *(texts.get((name, env), "-") for env in envs)] for name in names]
    return markdown_table(["method", *envs], lines)


def _comparison(row: Row) -> str:
    digits = DIGITS.get(row["metric"], ".4f")
    ours = error_text(row["mean"], row["stderr"], digits)
    verdict = " ".join(filter(None, (row["verdict"].strip("-"), share_of_steps(row)))) or "-"
    return f"{ours} / {PublishedScore(row['published_mean'], row['published_stderr']).text} / {verdict}"


def _tests(tested: Sequence[Row]) -> str:
    """Return a table of the tests against the published scores, or a line that there is none."""
    if not tested:
        return "No run can be tested against the paper."
    lines = []
    for row in tested:
        digits = DIGITS.get(row["metric"], ".4f")
        means = [format(row[name], digits) for name in ("tested_mean", "other_mean")]
        names = [row["env"], row["label"], millions(row["tested_steps"])]
        lines.append([*names, *means, *compared_texts(row, digits), row["chosen"]])
    return f"{markdown_table(TESTS, lines)}\n\n{CHOSEN_RULE}"


def _faults(number: int, trained: Sequence[Row]) -> str:
    faults = {env: published_fault(number, env) for env in dict.fromkeys(row["env"] for row in trained)}
    lines = "\n".join(f"- {env}: {fault}" for env, fault in faults.items() if fault)
    return f"Known faults of published scores:\n\n{lines}" if lines else ""


def _run_note(row: Row) -> str:
    low, high = row["published_steps_low"], row["published_steps_high"]
    published = "-" if low is None else f"{low:,}" if low == high else f"{low:,} to {high:,}"
    shorter = ", shorter than published" if low and row["steps"] < low else ""
    seeds = f"{counted(row['seeds'], 'seed')}{diverged_text(row['diverged'], row['seeds'])}"
    steps = f"{row['steps']:,} steps (published {published})"
    return f"- {row['env']}, {row['label']}: {steps}, {seeds}, {row['options']}{shorter}"


def _missing(rows: Sequence[Row]) -> str:
    missing = style.grouped([row for row in rows if row["seeds"] is None], itemgetter("env"))
    texts = [f"{env} ({', '.join(row['algo'] for row in of_task)})" for env, of_task in missing.items()]
    return f"Not run, shown as `-`: {', '.join(texts)}." if texts else "Every method of the published table was run."


def _draw(number: int, rows: Sequence[Row], metrics: Mapping[tuple[str, str], str]) -> Any:
    """Return a figure with a panel for each task and kind of reward: our means with intervals beside the published ones.

    `metrics` has the deployed metric of each run by its task and label; what was not run has that of the paper's task.
    """
    panels: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        metric = metrics.get((row["env"], row["label"])) or DEPLOYED[make(row["env"]).reward_type]
        panels.setdefault((row["env"], metric), []).append(row)
    tasks = [of_task for of_task in panels.values() if any(row["seeds"] for row in of_task)]
    columns = 2 if len(tasks) == 4 else min(3, len(tasks))
    lines = -(-len(tasks) // columns)
    figure, axes = style.new_figure(lines, columns, (max(4.6 * columns, 7.0), 3.3 * lines + 0.9))
    for axis in axes.flat[len(tasks) :]:
        axis.set_axis_off()
    palette = style.colours(row["algo"] for row in rows)
    for of_task, axis in zip(tasks, axes.flat, strict=False):
        _draw_task(axis, of_task, palette)
    figure.suptitle(HEADINGS[number])
    from matplotlib.patches import Patch

    ours, published = {"marker": "o", "color": "black", "linewidth": 1.8}, Patch(color="0.6", alpha=0.45)
    entries = {"Ours, mean and 95 % interval": ours, "Published, mean and 95 % interval of five seeds": published}
    style.legend_below(figure, entries, 2, fontsize="small")
    return figure


def _draw_task(axis: Any, rows: Sequence[Row], palette: dict[str, str]) -> None:
    axis.use_sticky_edges = False
    for position, row in enumerate(rows):
        if row["published_low"] is not None:
            low, high = row["published_low"], row["published_high"]
            axis.bar(position, high - low, 0.7, low, color="0.6", alpha=0.45, linewidth=0)
            middle = PublishedScore(row["published_mean"], "-").value
            axis.plot([position - 0.35, position + 0.35], [middle, middle], color="0.35", linewidth=1.5)
        if row["mean"] is not None:
            interval, marks = style.reach(Estimate.of_row(row, "mean")), {"fmt": "o", "linewidth": 1.8, "markersize": 6}
            axis.errorbar(position, row["mean"], interval, color=palette[row["algo"]], capsize=4, **marks)
    titles = [style.method_title(row["label"]) for row in rows]
    names = [title if len(title) <= LONGEST else f"{title[: LONGEST - 1]}…" for title in titles]
    slanted = {"rotation": 20, "ha": "right"} if any(row["label"] != row["algo"] for row in rows) else {}
    axis.set_xticks(range(len(rows)), names, fontsize="small", **slanted)
    axis.set(title=style.task_title(rows[0]["env"]), xlim=(-0.6, len(rows) - 0.4))
    metric = next(row["metric"] for row in rows if row["metric"])
    axis.set_ylabel(style.AXES[metric])
    axis.grid(axis="y", alpha=0.3)


TABLE1, TABLE2 = (
    Artefact(f"table{number}", PAPER_TASKS, runs_of(*METHODS), functools.partial(report, number), variants=True)
    for number in (1, 2)
)
