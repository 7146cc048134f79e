"""The paper's 27 cells from the runs in results/paper: `python -m benchmarks.paper.cells`.

A cell is a task and a method, trained at the paper's settings. It is tested against the paper's five seeds as `earl-jax
compare --against published` does, on some tasks also by the rewards of its life (`--metric continuing/reward`), p adjusted by
Holm over the methods of a task. The paper has no rewards of the oracle's life, and those of R3L on the door are not tested
(assets/published/faults.csv). Writes cells.csv, cells.md, lives.csv, lives.md, claims.md, cells.png, curves.png and lives.png
in the folders of tasks, and the tables `grid` and `summary` of the pages.
"""

import itertools
import math
from collections.abc import Sequence
from pathlib import Path

from benchmarks.output import RESULTS, pages_with, shrink, write_files
from benchmarks.paper import grid
from earl_jax.envs import PAPER_TASKS, make
from earl_jax.metrics.scores import CONTINUING
from earl_jax.paper.artefact import methods_on
from earl_jax.paper.claims import claims_text
from earl_jax.report.comparison import published_rows, table_text, verdict_text, with_verdicts
from earl_jax.report.leaderboard import commit_of
from earl_jax.report.plots import plot_runs
from earl_jax.report.pooling import read_methods
from earl_jax.report.published import RECONSTRUCTED, chosen_words, published_score, training_steps
from earl_jax.report.runs import Curves
from earl_jax.report.scores import SMOOTH
from earl_jax.report.tables import Row, csv_text, interval_text, markdown_table, millions
from earl_jax.runs.provenance import short_commit

RUNS = RESULTS / "paper"
TABLETOP, PEG = "tabletop_organization", "sawyer_peg"
LIVES = (TABLETOP, "sawyer_door", "franka_kitchen")
"""Tasks of which the rewards of the life are tested and drawn: some of them differ from the released ones."""
FORMER_VAPRL = "no_nearest_fallback-no_unmet_goals"
"""Variant of runs of VaPRL with the defaults that it had until 2026-11-23."""
NOT_RUN = "not run"
HEADER = (
    "task", "method", "seeds", "steps", "of", "mean [95 %]", "published", "difference [95 %]", "adjusted p", "verdict",
    "chosen", "printed (s.e.)", "largest critic loss", "commit",
)  # fmt: skip
COLUMNS = (
    "env", "algo", "run", "of", "printed", "seeds", "other_seeds", "steps", "mean", "other_mean", "low", "high", "difference",
    "difference_low", "difference_high", "p", "p_holm", "detectable", "chosen", "largest_critic_loss", "commit", "verdict",
)  # fmt: skip


def read_runs(root: Path = RUNS) -> list[Curves]:
    """Return the run of each of the paper's cells that has one: of VaPRL where it has no other, that with its former defaults."""
    cells = [root / env / algo for env in PAPER_TASKS for algo in methods_on(env)]
    choices = [
        [folder for folder in (cell, cell / FORMER_VAPRL) if (folder / "metrics.csv").exists()] for cell in cells
    ]
    return read_methods([folders[0] for folders in choices if folders])


def paper_tests(runs: Sequence[Curves], metric: str | None = None) -> list[Row]:
    """Return the tests of `runs` against the paper at all ages, by the deployed score or another `metric`."""
    return with_verdicts(published_rows(runs, metric))


def cells(runs: Sequence[Curves], tested: Sequence[Row]) -> list[Row]:
    """Return a row for each of the paper's cells, of which those without one of `runs` have a verdict only.

    `tested` are the `paper_tests` the runs.
    """
    tests = {(row["env"], row["first"]): row for row in tested if row["age"] == 1.0}
    measured = {(run.env, run.algo): _measured(run, tests[run.env, run.label]) for run in runs}
    names = [(env, algo) for env in PAPER_TASKS for algo in methods_on(env)]
    return [_cell(*name, measured.get(name, {"verdict": NOT_RUN})) for name in names]


def _measured(run: Curves, test: Row) -> Row:
    """Return what the row of a cell has of its run and of the test of it."""
    ends = {"low": "mean_low", "high": "mean_high", "difference_low": "low", "difference_high": "high"}
    return {
        **test,
        **{name: test[end] for name, end in ends.items()},
        "run": run.runs[0].path.as_posix().rpartition(f"/{run.env}/")[2],
        "chosen": chosen_words(run),
        "largest_critic_loss": float(run.metrics["critic_loss"].max()),
        "commit": short_commit(commit_of(run)),
    }


def _cell(env: str, algo: str, measured: Row) -> Row:
    """Return the row of a cell from what was `measured`."""
    score = None if env in RECONSTRUCTED else published_score(1, env, algo)
    names = {"env": env, "algo": algo, "of": training_steps(env), "printed": score.text if score else None}
    return {**{name: measured.get(name) for name in COLUMNS}, **names}


def cells_text(rows: list[Row]) -> str:
    """Return the rows of `cells` as a markdown table."""
    return markdown_table(HEADER, [_line(row) for row in rows])


def _line(row: Row) -> list[str]:
    names = [row["env"], row["algo"] + (", former defaults" if row["run"] not in (None, row["algo"]) else "")]
    printed, of = row["printed"] or "-", millions(row["of"])
    if row["seeds"] is None:
        return [*names, *"--", of, *"----", row["verdict"], "-", printed, *"--"]
    style, tests = ".3f" if make(row["env"]).sparse else ".0f", [*"---"]
    if row["p"] is not None and not math.isnan(row["p"]):
        difference = interval_text(row["difference"], row["difference_low"], row["difference_high"], style)
        tests = [format(row["other_mean"], style), difference, f"{row['p_holm']:.2g}"]
    return [
        *names, str(row["seeds"]), millions(row["steps"]), of, interval_text(row["mean"], row["low"], row["high"], style),
        *tests, verdict_text(row, lambda value: format(value, style)), row["chosen"], printed,
        f"{row['largest_critic_loss']:.2g}", row["commit"],
    ]  # fmt: skip


def files() -> dict[Path, str]:
    """Return the tables as files, and the pages that show some of them."""
    runs = read_runs()
    tested = paper_tests(runs)
    rows = cells(runs, tested)
    lives = [row for row in paper_tests([run for run in runs if run.env in LIVES], CONTINUING) if row["age"] == 1.0]
    claims = "\n\n".join(claims_text(number, runs) for number in (1, 2))
    tables = {"grid": grid.text(rows), "summary": grid.summary(rows)}
    return {
        RUNS / "cells.csv": csv_text(rows),
        RUNS / "cells.md": f"{cells_text(rows)}\n\n{table_text(tested)}\n",
        RUNS / "lives.csv": csv_text(lives),
        RUNS / "lives.md": f"{table_text(lives)}\n",
        RUNS / "claims.md": f"{claims}\n",
        **pages_with(tables),
    }


def draw() -> None:
    """Draw all cells, the deployed scores of each task, and the rewards of the life of some, over the released ones."""
    runs = read_runs()
    grid.draw(runs, RUNS / "cells.png")
    for env, own in itertools.groupby(runs, lambda run: run.env):
        of_task = list(own)
        pictures = {"curves": of_task[0].deployed_metric}
        if env in LIVES:
            pictures["lives"] = CONTINUING
        for name, metric in pictures.items():
            folders = [folder.path for run in of_task for folder in run.runs]
            picture = RUNS / env / f"{name}.png"
            shrink(plot_runs(folders, picture, metric=metric, size="page", smooth=SMOOTH, published=True))


if __name__ == "__main__":
    write_files(files())
    draw()
