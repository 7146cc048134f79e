"""The differences that could separate our runs from the published ones, and how each is settled by the runs at hand.

    python -m benchmarks.paper.differences

Each difference of `pairs` has tests of two sets of runs in results/paper, or of one and the released runs: `earl-jax compare`'s
permutation test at the last step that both have. A test without its runs is not made, and the table says `not run`. Writes
results/paper/{pairs.csv,pairs.md}, the figure of the cheetah and the table `differences` of the pages.
"""

import dataclasses
import itertools
from pathlib import Path

import numpy as np

from benchmarks.output import shrink, write_files
from benchmarks.paper.cells import FORMER_VAPRL, NOT_RUN, RUNS, TABLETOP, cells, paper_tests, read_runs
from benchmarks.paper.pairs import (
    CHEETAH,
    DIFFERENCES,
    HORIZONS,
    PUBLISHED,
    RELEASED_BIASED,
    RELEASED_BOOTSTRAPPED,
    SCRIPT_OPTIONS,
    Pair,
)
from benchmarks.paper.uniform_starts import RELEASED, SEEDS, read_seeds
from earl_jax.envs import make
from earl_jax.errors import InputError
from earl_jax.metrics.comparison import CANNOT_TELL, mean_interval
from earl_jax.metrics.scores import CONTINUING
from earl_jax.report.comparison import comparison_columns, pair_row, published_rows, verdict_text, with_verdicts
from earl_jax.report.plots import plot_runs
from earl_jax.report.pooling import read_all
from earl_jax.report.published import training_steps
from earl_jax.report.runs import Curves
from earl_jax.report.tables import Row, csv_text, interval_text, markdown_table, millions, number_text

HEADER = ("#", "ours, and what may differ", "first", "second", "steps", "first, mean [95 %]", "second, mean",
          "difference [95 %]", "p", "adjusted p", "settled")  # fmt: skip

TWO, ONE = "fbrl/commit_438fb6a", "fbrl/controllers_1"
"""FBRL's runs with two controllers and with one whose replay keeps all transitions, of figure 4."""
DEPLOYED = "deployed"
"""The metric of a pair that names none: success or return."""
LEAST = 0.001
"""The least p that is printed as a number."""
FAMILY = """In this table a family has the tests of one difference on a task, at all ages: those between our
runs, or those with the released runs. The detectable difference is that of a test without the
adjustment: five seeds against five have an adjusted p of 0.056 or more among seven tests."""


def comparisons(root: Path = RUNS, seeds: Path = SEEDS) -> list[Row]:
    """Return the rows of all tests whose runs are there, each with the `number` of its difference, its family for Holm."""
    rows = [{"number": "1", "metric": DEPLOYED, "released": False, **row} for row in starts_rows(read_seeds(seeds))]
    for entry in DIFFERENCES:
        tested = [(pair, row) for pair in entry.pairs if (row := _pair_row(root, pair))]
        rows += [
            {"number": entry.number, "metric": pair.metric or DEPLOYED, "released": pair.second == PUBLISHED, **row}
            for pair, row in tested
        ]
    return with_verdicts(rows, family=("number", "env", "released"))


def starts_rows(runs: dict[str, dict[str, np.ndarray]]) -> list[Row]:
    """Return the tests of FBRL with two controllers and with one: success from uniform starts, the loss to it, its share."""
    if not {TWO, ONE} <= runs.keys():
        return []
    own, uniform = ([runs[run][kind] for run in (TWO, ONE)] for kind in ("initial", RELEASED))
    losses = [success - other for success, other in zip(own, uniform, strict=True)]
    shares = [loss / success for loss, success in zip(losses, own, strict=True)]
    return [
        _scores_row("success from starts within 2.5", *uniform, rate=True),
        _scores_row("success from s0 minus that", *losses, rate=False),
        _scores_row("that difference as a share of the success from s0", *shares, rate=False),
    ]


def _scores_row(measure: str, scores: np.ndarray, others: np.ndarray, rate: bool) -> Row:
    own, test = mean_interval(scores, rate), comparison_columns(scores, others)
    return {
        "env": TABLETOP, "first": f"{TWO}, {measure}", "second": ONE, "steps": training_steps(TABLETOP),
        "seeds": len(scores), "other_seeds": len(others), **own.columns("mean", "mean_"), **test,
        "mean_over": "episodes from such starts",
    }  # fmt: skip


def _pair_row(root: Path, pair: Pair) -> Row | None:
    """Return the test of a pair, or None if a side has no run; further folders of a side may be missing."""
    first = _pooled(root, pair.first)
    if pair.second == PUBLISHED:
        rows = published_rows([first], pair.metric) if first else []
        return rows[-1] if rows else None
    second = _pooled(root, pair.second)
    return pair_row(first, second, pair.metric) if first and second else None


def _pooled(root: Path, names: tuple[str, ...]) -> Curves | None:
    """Return the pooled seeds of those of the folders that have a run, as runs of the task and method of their folder.

    A variant from a file has names of its own in its config.
    """
    folders = [root / name for name in names if (root / name / "metrics.csv").is_file()]
    if not folders:
        return None
    runs = read_all(folders)
    if len(runs) > 1:
        raise InputError(f"{', '.join(map(str, folders))} differ in their options, so their seeds cannot be pooled")
    env, label = folders[0].relative_to(root).as_posix().split("/", 1)
    config = dataclasses.replace(runs[0].config, env=env, algo=label.split("/")[0])
    return runs[0]._replace(config=config, label=label)


def table(rows: list[Row], own_cells: list[Row]) -> str:
    """Return the table of the differences from the rows of `comparisons` and those of the paper's cells."""
    lines = []
    for entry in DIFFERENCES:
        tested = [_line(row) for row in rows if row["number"] == entry.number]
        tested += [_cell_line(row) for row in own_cells if (row["env"], row["algo"]) == entry.cell and row["seeds"]]
        lines += [[entry.number, entry.what, *line] for line in tested or [["-"] * 8 + [NOT_RUN]]]
    for previous, line in reversed(list(itertools.pairwise(lines))):
        line[:2] = ["", "the same"] if previous[0] == line[0] else line[:2]
    return markdown_table(HEADER, lines)


def _line(row: Row) -> list[str]:
    verdict = verdict_text(row, lambda value: _number(row, value))
    settled = verdict if verdict.startswith(CANNOT_TELL) else f"the first is {verdict}"
    first, second = (_short(row[side]) for side in ("first", "second"))
    return [
        f"{row['env']} {first}, {row['seeds']} seeds", f"{second}, {row['other_seeds']} seeds",
        millions(row["steps"]), _interval(row, "mean", "mean_low", "mean_high"), _number(row, row["other_mean"]),
        _interval(row, "difference", "low", "high"), *(number_text(row[p], ".2g", LEAST) for p in ("p", "p_holm")), settled,
    ]  # fmt: skip


def _short(name: str) -> str:
    """Return the name of a side with one word for the released script's options, and one for VaPRL's former defaults."""
    return name.replace(SCRIPT_OPTIONS, "released").replace(FORMER_VAPRL, "former")


def _cell_line(row: Row) -> list[str]:
    mean = interval_text(row["mean"], row["low"], row["high"])
    names = f"{row['env']} {row['algo']}, {row['seeds']} seeds", f"published, {millions(row['of'])} steps, 5 seeds"
    return [*names, millions(row["steps"]), mean, f"{row['other_mean']:.3f}", *"---", f"run; {verdict_text(row)}"]


def _number(row: Row, value: float) -> str:
    """Return a success with three decimals, a reward of a life with three digits, or a return with none."""
    is_return = row["metric"] == DEPLOYED and not make(row["env"]).sparse
    return number_text(value, ".3g" if row["metric"] == CONTINUING else ".0f" if is_return else ".3f")


def _interval(row: Row, *names: str) -> str:
    value, low, high = (_number(row, row[name]) for name in names)
    return f"{value} [{low}, {high}]"


def files() -> dict[Path, str]:
    """Return the tests as files."""
    rows, runs = comparisons(), read_runs()
    own_cells = cells(runs, paper_tests(runs))
    return {RUNS / "pairs.csv": csv_text(rows), RUNS / "pairs.md": f"{table(rows, own_cells)}\n\n{FAMILY}\n"}


def draw() -> None:
    """Draw the return of seeds 5 to 9 of difference 2, which trained longer than the first five, over their steps."""
    folders = [RUNS / names[1] for names in RELEASED_BOOTSTRAPPED + RELEASED_BIASED]
    names = [f"Reset every {horizon:,} steps{update}" for update in ("", ", biased update") for horizon in HORIZONS]
    shrink(plot_runs(folders, RUNS / CHEETAH / "curves.png", names, metric="deployed/return", smooth=5))


if __name__ == "__main__":
    write_files(files())
    draw()
