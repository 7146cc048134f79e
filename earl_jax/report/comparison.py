"""Comparisons of runs with each other and with the published scores, as rows, tables and a figure."""

import itertools
import math
import textwrap
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from earl_jax.errors import InputError, require_known
from earl_jax.metrics.comparison import (
    CANNOT_TELL,
    Sample,
    detectable_difference,
    holm,
    permutation,
    smallest_p,
    verdict as verdict_of,
    welch,
)
from earl_jax.metrics.scores import DEFAULT, Window
from earl_jax.metrics.statistics import Estimate
from earl_jax.options.values import counted
from earl_jax.report.pooling import read_methods
from earl_jax.report.published import (
    FAMILY_RULE,
    RECONSTRUCTED,
    TEST_RULE,
    published_score,
    released_beside,
    share_text,
    training_steps,
)
from earl_jax.report.runs import Curves, common_step
from earl_jax.report.scores import interval_of, over_same_steps, seed_scores
from earl_jax.report.style import PICTURES, grouped, method_title, new_figure, reach, save, task_title
from earl_jax.report.tables import (
    INTERVALS,
    TABLES,
    Column,
    Row,
    Table,
    interval_text,
    millions,
    number_text,
    windows_text,
    write,
)  # fmt: skip
from earl_jax.runs.files import require_suffix, warn

OTHER_TASK = "not compared: the task is our reconstruction"
OTHER_METRIC = "one is scored by success and the other by return"
FILES = (*TABLES, *PICTURES)
"""The suffixes of files that `write_comparison` writes."""
LETTERS = 36
"""Letters in a line of the name of a difference in a picture."""
AGES = (0.25, 0.5, 0.75, 1.0)
"""Shares of the steps that a run and the released ones have in common, at which they are compared."""
RULE = (
    f"The score of a seed is its mean over {{window}}, of as many steps on both sides. {INTERVALS} Those of differences are "
    f"Welch's. p: the permutation test between runs. {FAMILY_RULE.format(family='the comparisons at an age')}"
)
COLUMNS: tuple[Column, ...] = (
    ("task", lambda row: row["env"]),
    ("first", lambda row: f"{row['first']}, {counted(row['seeds'], 'seed')}"),
    ("second", lambda row: f"{row['second']}, {counted(row['other_seeds'], 'seed')}"),
    ("steps", lambda row: millions(row["steps"])),
    ("first, mean [95 %]", lambda row: interval_text(*Estimate.of_row(row, "mean"), ".3g")),
    ("second, mean", lambda row: number_text(row["other_mean"])),
    ("difference [95 %]", lambda row: interval_text(*Estimate.of_row(row, "difference"), ".3g")),
    ("p", lambda row: number_text(row["p"])),
    ("adjusted p", lambda row: number_text(row["p_holm"])),
    ("verdict", lambda row: verdict_text(row)),
)


def compare(
    folders: Sequence[str | Path],
    against: Literal["runs", "published"] = "runs",
    metric: str | None = None,
    window: Window = DEFAULT,
) -> list[Row]:
    """Return a row for each pair of methods on a task, or for each method beside its published score.

    Runs of the same task, method and options are pooled. Against the released runs there is a row at each of `AGES`.
    `metric` is a column of metrics.csv, such as `deployed/success_wide`; None means the deployed score. The released
    runs contain the deployed score and `continuing/reward`. A pair without a common step or metric, and a run without
    `metric`, are left out with a `RunWarning`.

    Raises:
        ValueError: a folder is not a run, it has no such metric, or there is nothing to compare.
    """
    require_known("against", against, ("runs", "published"))
    runs = read_methods(folders, window, metric)
    if against == "published":
        rows, needed = published_rows(runs, metric), "a task and a method of the paper"
        compared = {(row["env"], row["first"]) for row in rows}
        for run in runs:
            if (run.env, run.label) not in compared:
                warn(f"{run.label} on {run.env} is not compared: {_nothing_published(run, metric)}")
    else:
        rows, needed = [], "two methods on one task, or --against published"
        for first, second in (pair for pair in itertools.combinations(runs, 2) if pair[0].env == pair[1].env):
            same_metric = metric is not None or first.deployed_metric == second.deployed_metric
            if same_metric and (row := pair_row(first, second, metric)):
                rows.append(row)
            else:
                cause = "one ends before the other's first evaluation" if same_metric else OTHER_METRIC
                apart = f"{first.label} and {second.label} on {first.env} are not compared"
                warn(f"{apart}: {cause}")
    if not rows:
        raise InputError(f"there is nothing to compare; compare needs runs of {needed}")
    return with_verdicts(rows)


def with_verdicts(rows: list[Row], family: Sequence[str] = ("env", "age"), tests: int = 0) -> list[Row]:
    """Return `rows` with p adjusted by Holm over those of the same `family`, and the verdict of those that have none yet.

    By default a family has the comparisons of a task at the same age. It has at least so many `tests`.
    """
    for members in grouped(rows, lambda row: tuple(row.get(name) for name in family)).values():
        for row, adjusted in zip(members, holm([row["p"] for row in members], tests), strict=True):
            row["p_holm"] = float(adjusted)
            row["verdict"] = row["verdict"] or verdict_of(row["difference"], row["p_holm"])
    return rows


def pair_row(first: Curves, second: Curves, metric: str | None = None, age: float = 1.0) -> Row | None:
    """Return the comparison of two methods on a task after the share `age` of the steps that both have, p not adjusted.

    It is None before the first evaluation of one.
    """
    step = common_step(first, second, age)
    if step is None:
        return None
    scores, others = (seed_scores(curves, metric) for curves in over_same_steps((first, second), step))
    return _row(first, step, scores, second.label, others, metric) | {"age": age}


def published_rows(runs: Sequence[Curves], metric: str | None = None) -> list[Row]:
    """Return the comparisons of each of `runs` with the paper, without an adjusted p; none where the paper has nothing.

    They are with the released runs at each of `AGES`, by the deployed score or another `metric`, or with the printed score of
    a task without such runs.
    """
    return [row for run in runs for row in _released_rows(run, metric) or ([] if metric else _printed_rows(run))]


def _released_rows(curves: Curves, metric: str | None) -> list[Row]:
    """Return the comparisons with the released runs at each age that both sides have reached."""
    released = released_beside(curves)
    if released is None or (metric or curves.deployed_metric) not in released.metrics:
        return []
    published = released._replace(label="published")
    return [row for age in AGES if (row := pair_row(curves, published, metric, age))]


def _printed_rows(curves: Curves) -> list[Row]:
    """Return the comparison of a run of the published length with the printed score; of another, a row without a test."""
    score = published_score(1, curves.env, curves.algo) if curves.comparable else None
    if not score or not score.sample:
        return []
    step, length = curves.length, training_steps(curves.env)
    row = _row(curves, step, seed_scores(curves), f"published {score.text}", score.sample)
    if curves.env in RECONSTRUCTED:
        row |= untested(OTHER_TASK) | {"second": "published", "other_mean": math.nan}
    elif (released := released_beside(curves)) is not None and step < released.steps[0]:
        row |= untested(f"not compared before step {released.steps[0]:,}, the first evaluation of the released runs")
    elif step < length:
        row |= untested(f"not compared at {share_text(step, length)} of the published steps")
    return [row]


def _nothing_published(curves: Curves, metric: str | None) -> str:
    """Return why the paper has nothing beside a run."""
    if not curves.comparable:
        return "its task, its kind of reward or its setting is not that of the paper's tables"
    if published_score(1, curves.env, curves.algo) is None:
        return f"the paper has no {curves.algo} on this task"
    return f"the released runs have no {metric}" if metric else "it ends before their first evaluation"


def _row(
    first: Curves, step: int, scores: np.ndarray, name: str, other: np.ndarray | Sample, metric: str | None = None
) -> Row:
    own, test = interval_of(first, scores, metric), comparison_columns(scores, other)
    return {
        "env": first.env, "first": first.label, "second": name, "steps": step, "seeds": len(scores),
        "other_seeds": test["other_seeds"], **own.columns("mean", "mean_"), **test, "age": 1.0, "mean_over": first.window.text,
    }  # fmt: skip


def comparison_columns(own: np.ndarray | Sample, other: np.ndarray | Sample, prefix: str = "") -> Row:
    """Return the columns of the test of `own` against `other`, before `with_verdicts`.

    It is the permutation test of scores [N] of seeds, or Welch's where one of the two is a `Sample`. The names of the ends of
    its interval start with `prefix`.
    """
    first, second = (part if isinstance(part, Sample) else Sample.of(part) for part in (own, other))
    result = welch(first, second) if isinstance(own, Sample) or isinstance(other, Sample) else permutation(own, other)
    return {
        "seeds": first.seeds,
        "other_seeds": second.seeds,
        "other_mean": second.mean,
        **Estimate(result.difference, result.low, result.high).columns("difference", prefix),
        "p": result.p,
        "verdict": "",
        "detectable": detectable_difference(first, second),
    }


def untested(verdict: str) -> Row:
    """Return the columns of a test that was not made, with its cause as the `verdict`."""
    return dict.fromkeys(("difference", "low", "high", "p", "detectable"), math.nan) | {"verdict": verdict}


def verdict_text(row: Row, number: Callable[[float], str] = number_text, words: Mapping[str, str] | None = None) -> str:
    """Return the verdict of a row, or the one of `words` for it; `cannot tell` has its cause or the detectable difference.

    `number` formats this difference, which its test would find with a probability of 80 %.
    """
    text = str((words or {}).get(row["verdict"]) or row["verdict"])
    if row["verdict"] != CANNOT_TELL:
        return text
    if not math.isfinite(row["difference"]):
        return f"{text}: a score is not finite"
    if math.isnan(row["p"]) and row["detectable"] != 0:
        return f"{text}: a test needs two seeds of each"
    if math.isnan(row["detectable"]):
        return f"{text}: fewer than three seeds do not say what they could detect"
    if row["detectable"] == 0:
        return f"{text}: all seeds are equal" if row["difference"] == 0 else f"{text}: no spread"
    if math.isclose(row["p"], smallest_p(row["seeds"], row["other_seeds"])):
        return f"{text}: the seeds do not overlap, but so few can have no smaller p"
    return f"{text} (detectable {number(row['detectable'])})"


def compared_texts(row: Row, style: str = ".3g", **words: str) -> list[str]:
    """Return the difference of a row with its interval, p, adjusted p and `verdict_text`."""
    difference = interval_text(*Estimate.of_row(row, "difference"), style)
    return [difference, number_text(row["p"]), number_text(row["p_holm"]), verdict_text(row, words=words)]


def table_text(rows: Sequence[Row], width: int | None = None) -> str:
    """Return the rows of `compare` as a table with the rule below it, markdown or for a terminal of `width` columns."""
    return _table(rows).text(width)


def _table(rows: Sequence[Row]) -> Table:
    rule = RULE.format(window=windows_text(row["mean_over"] for row in rows))
    published = any(row["second"].startswith("published") for row in rows)
    return Table.of(COLUMNS, rows, [f"{rule} {TEST_RULE}" if published else rule])


def write_comparison(rows: Sequence[Row], path: Path) -> Path:
    """Write the rows of `compare` to `path`, a table (.md, .tex, .csv) or a figure (.png, .pdf, .svg), and return it.

    Raises:
        ValueError: `path` has another suffix, or matplotlib is not installed.
    """
    require_suffix(path, FILES, "comparisons")
    if path.suffix in PICTURES:
        return save(_draw(rows), path)
    write(rows, path, _table)
    return path


def _draw(rows: Sequence[Row]) -> Any:
    """Return a figure with the difference and interval of each row, a panel for each task."""
    drawn = [row for row in rows if not math.isnan(row["low"])]
    if not drawn:
        raise InputError(
            "no difference has an interval to draw: each side needs three seeds, and not all of them may be equal"
        )
    if missing := len(rows) - len(drawn):
        warn(f"{counted(missing, 'difference')} without an interval: not in the picture")
    tasks = grouped(drawn, lambda row: row["env"])
    dated = len({row["age"] for row in drawn}) > 1
    names = {env: [textwrap.fill(_difference(row, dated), LETTERS) for row in chosen] for env, chosen in tasks.items()}
    height = 0.4 + 0.16 * max(name.count("\n") for of_task in names.values() for name in of_task)
    figure, axes = new_figure(1, len(tasks), (5.4 * len(tasks), 1.2 + height * max(map(len, tasks.values()))))
    for (env, chosen), axis in zip(tasks.items(), axes[0], strict=True):
        for position, row in enumerate(chosen):
            colour = "C0" if row["verdict"] in ("above", "below") else "0.5"
            interval = reach(Estimate.of_row(row, "difference"))
            axis.errorbar(row["difference"], position, xerr=interval, fmt="o", color=colour, capsize=3)
        axis.set_yticks(range(len(chosen)), names[env], fontsize="small")
        axis.axvline(0.0, color="black", linewidth=0.8)
        axis.set(title=task_title(env), xlabel="Difference of means, 95 % interval", ylim=(len(chosen) - 0.5, -0.5))
    return figure


def _difference(row: Row, dated: bool) -> str:
    """Return what a row compares, with the steps if rows are `dated`, because there are several ages."""
    text = f"{method_title(row['first'])} − {method_title(row['second'])}"
    return f"{text}, {millions(row['steps'])}" if dated else text
