"""The runs of a sweep ranked by their score, with what can and what cannot be told apart from the best of a task."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from earl_jax.errors import InputError
from earl_jax.metrics.comparison import LEVEL, Sample, holm, mean_interval, permutation, smallest_p, verdict, welch
from earl_jax.report.runs import Curves, MethodRuns, options_text, read_methods
from earl_jax.report.scores import recent_scores
from earl_jax.report.style import task_order
from earl_jax.report.tables import interval_text, number_text, shown_table, wrapped

Row = dict[str, Any]
Test = Literal["permutation", "welch"]
HEADER = ("rank", "run", "seeds", "steps", "score [95 %]", "best minus this [95 %]", "adjusted p", "verdict")
RULE = (
    "Score: mean over seeds and over the evaluations of the last 100,000 steps, with Student's 95 % interval. Each run is "
    "compared with the best of its task by {test}, p adjusted by Holm over the comparisons of the task. Runs that are shorter "
    "than the longest of the task are listed after the others and not compared."
)
TESTS = {"permutation": "the permutation test (interval: Welch's)", "welch": "Welch's test"}
OPTIMISM = (
    "The best of many runs scores above its true mean, because chance helped to select it. Train it again with other seeds, "
    "for example: earl-jax train --config DIR --seeds 100:110 --out NEW"
)


def best(folders: Sequence[Path], test: Test = "permutation") -> list[Row]:
    """Return a row for each method and its options, by task, the best first. Seeds of the same are pooled.

    `verdict` is `best`, `below` if the adjusted p of its difference from the best is under 5 %, `cannot tell`, or `shorter`.
    `least_p` is the smallest adjusted p that the test could give with these numbers of seeds.

    Raises:
        ValueError: a folder holds no run that can be read, or runs of a task are scored by different metrics.
    """
    groups = read_methods(folders)
    rows: list[Row] = []
    for env in task_order(group.env for group in groups):
        rows += _ranked([group for group in groups if group.env == env], test)
    return rows


def _ranked(groups: Sequence[MethodRuns], test: Test) -> list[Row]:
    """Return the rows of one task."""
    if len({group.curves.deployed_metric for group in groups}) > 1:
        raise InputError(f"runs of {groups[0].env} are scored by success and by return; rank them apart")
    longest = max(_last(group.curves) for group in groups)
    groups = sorted(groups, key=lambda group: (_last(group.curves) < longest, -recent_scores(group.curves).mean()))
    leader = recent_scores(groups[0].curves)
    rows = [_row(rank, group) for rank, group in enumerate(groups, 1)]
    rows[0]["verdict"] = "best"
    tested = [(row, group) for row, group in zip(rows[1:], groups[1:], strict=True) if row["steps"] == longest]
    for row, group in tested:
        scores = recent_scores(group.curves)
        result = permutation(leader, scores) if test == "permutation" else welch(Sample.of(leader), Sample.of(scores))
        row |= {
            "difference": result.difference,
            "difference_low": result.low,
            "difference_high": result.high,
            "p": result.p,
        }
        row["least_p"] = _least_p(len(leader), len(scores), test) * len(tested)
    for (row, _), adjusted in zip(tested, holm([row["p"] for row, _ in tested]), strict=True):
        row["p_holm"] = float(adjusted)
        row["verdict"] = {"above": "below"}.get(verdict(row["difference"], row["p_holm"]), "cannot tell")
    return rows


def _row(rank: int, group: MethodRuns) -> Row:
    scores = recent_scores(group.curves)
    interval = mean_interval(scores)
    return {
        "env": group.env, "rank": rank, "method": group.algo, "label": group.label,
        "options": options_text(group.curves.options), "metric": group.curves.deployed_metric, "seeds": len(scores),
        "steps": _last(group.curves), "score": interval.value, "low": interval.low, "high": interval.high,
        "difference": math.nan, "difference_low": math.nan, "difference_high": math.nan, "p": math.nan, "p_holm": math.nan,
        "least_p": math.nan, "verdict": "shorter",
    }  # fmt: skip


def _last(curves: Curves) -> int:
    return int(curves.steps[-1])


def _least_p(first: int, second: int, test: Test) -> float:
    """Return the smallest p that the test of `first` against `second` seeds can give; Welch's has no such limit."""
    if min(first, second) < 2:
        return math.nan
    return smallest_p(first, second) if test == "permutation" else 0.0


def best_text(rows: Sequence[Row], test: Test = "permutation", top: int = 20, width: int | None = None) -> str:
    """Return a table of the `top` rows of each task, what cannot be told from its best, and the rule."""
    parts: list[str] = []
    for env in dict.fromkeys(row["env"] for row in rows):
        of_task = [row for row in rows if row["env"] == env]
        parts += [f"{env}, {of_task[0]['metric']}", shown_table(HEADER, [_cells(row) for row in of_task[:top]], width)]
        hidden = f"{len(of_task) - top} more are not shown. " if len(of_task) > top else ""
        parts.append(wrapped(hidden + _verdict_text(of_task), width))
    notes = [RULE.format(test=TESTS[test]), *([OPTIMISM] if len(rows) > 1 else [])]
    return "\n\n".join([*parts, *(wrapped(note, width) for note in notes)])


def _verdict_text(rows: Sequence[Row]) -> str:
    """Return which of the runs of a task cannot be told from its best, and whether any of them could be."""
    tested = [row for row in rows if not math.isnan(row["difference"])]
    unclear = [row for row in tested if row["verdict"] == "cannot tell"]
    if not tested:
        return "There is no other run of the same length to compare with."
    text = f"Of {len(tested)} others of the same length, {len(unclear)} cannot be told from the best"
    text += f": rank {', '.join(str(row['rank']) for row in unclear)}." if unclear else "."
    if all(math.isnan(row["p"]) for row in tested):
        return text + " A test needs two seeds of each."
    if min(row["least_p"] for row in tested if not math.isnan(row["p"])) >= LEVEL:
        least = min(row["least_p"] for row in tested)
        text += (
            f" None could be: with these seeds the smallest adjusted p of so many permutation tests is {least:.2g}. "
            "Use more seeds, fewer runs, or --test welch."
        )
    return text


def _cells(row: Row) -> list[str]:
    difference = interval_text(row["difference"], row["difference_low"], row["difference_high"])
    return [
        str(row["rank"]), row["label"], str(row["seeds"]), f"{row['steps']:,}",
        interval_text(row["score"], row["low"], row["high"]), difference, number_text(row["p_holm"]), row["verdict"],
    ]  # fmt: skip
