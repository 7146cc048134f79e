"""The runs of a sweep ranked by their score, with tests of which runs differ from the best of their task."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from earl_jax.errors import require_known
from earl_jax.metrics.comparison import CANNOT_TELL, LEVEL, ROUNDING, Sample, smallest_p
from earl_jax.metrics.continuing import diverged_text
from earl_jax.metrics.scores import DEFAULT, Window
from earl_jax.metrics.statistics import Estimate
from earl_jax.options.values import COUNT, counted, require
from earl_jax.report.comparison import comparison_columns, verdict_text, with_verdicts
from earl_jax.report.pooling import read_methods
from earl_jax.report.published import FAMILY_RULE
from earl_jax.report.runs import Curves, options_text
from earl_jax.report.scores import interval_of, over_same_steps, seed_scores
from earl_jax.report.style import grouped
from earl_jax.report.tables import INTERVALS, Column, Row, Table, interval_text, number_text, windows_text, wrapped

Test = Literal["permutation", "welch"]
COLUMNS: tuple[Column, ...] = (
    ("rank", lambda row: row["rank"]),
    ("run", lambda row: row["label"]),
    ("seeds", lambda row: f"{row['seeds']}{diverged_text(row['diverged'], row['seeds'])}"),
    ("steps", lambda row: f"{row['steps']:,}"),
    ("score [95 %]", lambda row: interval_text(*Estimate.of_row(row, "score"))),
    ("best minus this [95 %]", lambda row: interval_text(*Estimate.of_row(row, "difference"))),
    ("adjusted p", lambda row: number_text(row["p_holm"])),
    ("verdict", verdict_text),
)
TIED = "tied"
RULE = (
    "Score: mean over seeds and over {window}. Runs of one length are scored over as many steps. {intervals} Each run is "
    f"compared with the best of its task by {{test}}. {FAMILY_RULE.format(family='all pairs, since the scores chose the best')} "
    "Runs that are shorter than the longest of the task are listed after the others and not compared."
)
TESTS = {"permutation": "the permutation test (interval: Welch's)", "welch": "Welch's test"}
OPTIMISM = (
    "The best of many runs scores above its true mean, because chance helped to select it. Train it again with other seeds, "
    "for example: earl-jax train --config DIR --seeds 100:110 --out NEW"
)


def best(
    folders: Sequence[str | Path], test: Test = "permutation", window: Window = DEFAULT, metric: str | None = None
) -> list[Row]:
    """Return a row for each method and its options, by task and metric, the best first. Seeds of the same are pooled.

    The best has the highest score by `metric`, a column of metrics.csv; None is the deployed score.
    `verdict` is `best`, `tied` for runs that share the highest score, `below` if the adjusted p of the difference from the best
    is under 5 %, `cannot tell`, or `shorter`. Runs of which a score is nan come after the others of their length.
    `least_p` is the smallest adjusted p that the test could give with these numbers of seeds.

    Raises:
        ValueError: no run that can be read has a score by this metric.
    """
    require_known("test", test, TESTS)
    methods = read_methods(folders, window, metric)
    tasks = grouped(methods, lambda curves: (curves.env, metric or curves.deployed_metric))
    return [row for runs in tasks.values() for row in _ranked(runs, test, metric)]


def _ranked(runs: Sequence[Curves], test: Test, metric: str | None) -> list[Row]:
    longest = max(curves.length for curves in runs)
    pairs = [
        (curves, seed_scores(same, metric=metric))
        for of_length in grouped(runs, lambda curves: curves.length).values()
        for curves, same in zip(of_length, over_same_steps(of_length), strict=True)
    ]
    pairs.sort(key=lambda pair: (pair[0].length < longest, np.isnan(pair[1].mean()), -pair[1].mean()))
    rows = [_row(rank, curves, scores, metric) for rank, (curves, scores) in enumerate(pairs, 1)]
    leader = pairs[0][1]
    tested = [(row, scores) for row, (_, scores) in zip(rows[1:], pairs[1:], strict=True) if row["steps"] == longest]
    for row, scores in tested:
        sides = (leader, scores) if test == "permutation" else (Sample.of(leader), Sample.of(scores))
        columns = comparison_columns(*sides, "difference_") | {"seeds": len(scores), "other_seeds": len(leader)}
        row |= {name: value for name, value in columns.items() if name in row}
        least = smallest_p(len(leader), len(scores)) if test == "permutation" else 0.0  # Welch's p has no limit
        row["least_p"] = least if min(len(leader), len(scores)) > 1 else math.nan
    pairs_tested = math.comb(1 + sum(not math.isnan(row["p"]) for row, _ in tested), 2)
    for row in with_verdicts([row for row, _ in tested], tests=pairs_tested):
        row["least_p"] = min(row["least_p"] * pairs_tested, 1.0)  # nan stays
        row["verdict"] = {"above": "below"}.get(row["verdict"], row["verdict"])
    top = rows[0]["score"]
    tied = [row for row in rows if row["steps"] == longest and math.isclose(row["score"], top, rel_tol=ROUNDING)]
    for row in tied:
        row |= {"rank": 1, "verdict": TIED if len(tied) > 1 else "best"}
    return rows


def _row(rank: int, curves: Curves, scores: np.ndarray, metric: str | None) -> Row:
    """Return the row of a run that is not compared."""
    interval = interval_of(curves, scores, metric)
    return {
        "env": curves.env, "rank": rank, "method": curves.algo, "label": curves.label, "options": options_text(curves.options),
        "metric": metric or curves.deployed_metric, "seeds": len(scores), "diverged": curves.diverged, "steps": curves.length,
        "mean_over": curves.window.text, **interval.columns("score"),
        **dict.fromkeys(("difference", "difference_low", "difference_high", "p", "p_holm", "least_p", "detectable"), math.nan),
        "other_seeds": len(scores),
        "verdict": CANNOT_TELL if math.isnan(interval.value) else "shorter",
    }  # fmt: skip


def best_text(rows: Sequence[Row], test: Test = "permutation", top: int = 20, width: int | None = None) -> str:
    """Return a table of the `top` rows of each task, what cannot be told from its best, and the rule.

    Raises:
        ValueError: `top` is not a whole number, or less than 1.
    """
    require("top", top, COUNT)
    parts: list[str] = []
    for (env, metric), of_task in grouped(rows, lambda row: (row["env"], row["metric"])).items():
        hidden = f"{len(of_task) - top} more are not shown. " if len(of_task) > top else ""
        table = Table.of(COLUMNS, of_task[:top], [hidden + _verdict_text(of_task)])
        parts += [f"{env}, {metric}", table.text(width)]
    window = windows_text(row["mean_over"] for row in rows)
    rule = RULE.format(test=TESTS[test], window=window, intervals=INTERVALS)
    notes = [rule, OPTIMISM] if len(rows) > 1 else [rule]
    return "\n\n".join([*parts, *(wrapped(note, width) for note in notes)])


def _ranges(ranks: Sequence[int]) -> str:
    """Return ascending `ranks` as text, those of three and more that follow each other by the first and the last."""
    runs = grouped(enumerate(sorted(set(ranks))), lambda pair: pair[1] - pair[0]).values()
    spans = [[str(rank) for _, rank in run] for run in runs]
    return ", ".join(f"{span[0]} to {span[-1]}" if len(span) > 2 else ", ".join(span) for span in spans)


def _verdict_text(rows: Sequence[Row]) -> str:
    """Return which of the runs of a task cannot be told from its best, and whether any of them could be."""
    others = [row for row in rows[1:] if row["steps"] == rows[0]["steps"]]
    tested = [row for row in others if not math.isnan(row["difference"])]
    unclear = [row for row in tested if row["verdict"] in (CANNOT_TELL, TIED)]
    if not tested:
        return f"There is no other run {'with a finite score' if others else 'of the same length to compare with'}."
    text = f"Of {counted(len(tested), 'other')} of the same length, {len(unclear)} cannot be told from the best"
    text += f": rank {_ranges([row['rank'] for row in unclear])}." if unclear else "."
    least = min((row["least_p"] for row in tested if not math.isnan(row["p"])), default=math.nan)
    if math.isnan(least):
        return text + " A test needs two seeds of each."
    if least >= LEVEL:
        text += (
            f" None could be told: with these seeds the smallest adjusted p of so many permutation tests is {least:.2g}. "
            "Use more seeds, fewer runs, or --test welch."
        )
    return text
