"""The paper's 27 cells from the runs in results/paper: `python -m benchmarks.paper.cells`.

A cell is a task and a method, trained at the paper's settings. It is tested against the paper's five seeds as `earl-jax
compare --against published` does. Writes cells.csv, cells.md, cells.png, curves.png and lives.png in the folders of tasks, and
the tables `grid` and `summary` of the pages.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.output import RESULTS, csv_text, pages_with, shrink, write_files
from benchmarks.paper import grid
from earl_jax.envs import PAPER_TASKS, make
from earl_jax.paper.artefact import methods_on, training_steps
from earl_jax.paper.claims import claims_text
from earl_jax.report.comparison import published_rows, table_text, verdict_text, with_verdicts
from earl_jax.report.plots import plot_runs
from earl_jax.report.published import RECONSTRUCTED, chosen_words, published_score
from earl_jax.report.runs import MethodRuns, read_methods
from earl_jax.report.tables import interval_text, markdown_table, millions
from earl_jax.runs.folder import RunFolder
from earl_jax.runs.provenance import made_by, short_commit

RUNS = RESULTS / "paper"
TABLETOP, PEG = "tabletop_organization", "sawyer_peg"
LIVES = (TABLETOP, "sawyer_door", "franka_kitchen")
"""Tasks of which the rewards of the life are drawn: some of them differ from the released ones."""
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
Row = dict[str, Any]


def cells(root: Path = RUNS) -> list[Row]:
    """Return a row for each of the paper's cells, of which those without a run have a verdict only."""
    names = [(env, algo) for env in PAPER_TASKS for algo in methods_on(env)]
    folders = {name: folder for name in names if (folder := _folder(root.joinpath(*name)))}
    runs = read_methods(list(folders.values()))
    tests = {(row["env"], row["first"]): row for row in comparisons_at_ages(runs) if row["age"] == 1.0}
    measured = {}
    for run in runs:
        test, folder = tests[run.env, run.label], folders[run.env, run.algo]
        ends = {"low": "mean_low", "high": "mean_high", "difference_low": "low", "difference_high": "high"}
        measured[run.env, run.algo] = {
            **test,
            **{name: test[end] for name, end in ends.items()},
            "run": folder.relative_to(root / run.env).as_posix(),
            "chosen": chosen_words(run.curves),
            "largest_critic_loss": float(run.curves.metrics["critic_loss"].max()),
            "commit": short_commit(commit_of(folder)),
        }
    return [_cell(*name, measured.get(name, {"verdict": NOT_RUN})) for name in names]


def comparisons_at_ages(runs: Sequence[MethodRuns], metric: str | None = None) -> list[Row]:
    """Return the comparisons of `runs` with the paper at each age, p adjusted over the methods of a task at an age.

    The `metric` is by default the deployed score.
    """
    return with_verdicts(published_rows(runs, metric))


def _folder(cell: Path) -> Path | None:
    """Return the folder of the run of a cell, which is VaPRL's with its former defaults where it has no other; None without."""
    return next((folder for folder in (cell, cell / FORMER_VAPRL) if (folder / "metrics.csv").exists()), None)


def _cell(env: str, algo: str, measured: Row) -> Row:
    """Return the row of a cell from what was `measured`."""
    score = None if env in RECONSTRUCTED else published_score("table1", env, algo)
    names = {"env": env, "algo": algo, "of": training_steps(env), "printed": score.text if score else None}
    return {**{name: measured.get(name) for name in COLUMNS}, **names}


def commit_of(folder: Path) -> str:
    """Return the commit that made the run of `folder`, or the release where it was made by a wheel."""
    return made_by(json.loads((folder / "config.json").read_text())["provenance"])


def cells_text(rows: list[Row]) -> str:
    """Return the rows of `cells` as a markdown table."""
    return markdown_table(HEADER, [_line(row) for row in rows])


def _tested(row: Row) -> bool:
    return row["p"] is not None and row["p"] == row["p"]


def _line(row: Row) -> list[str]:
    names = [row["env"], row["algo"] + (", former defaults" if row["run"] not in (None, row["algo"]) else "")]
    printed, of = row["printed"] or "-", millions(row["of"])
    if row["seeds"] is None:
        return [*names, *"--", of, *"----", row["verdict"], "-", printed, *"--"]
    style, tests = ".3f" if make(row["env"]).sparse else ".0f", [*"---"]
    if _tested(row):
        difference = interval_text(row["difference"], row["difference_low"], row["difference_high"], style)
        tests = [format(row["other_mean"], style), difference, f"{row['p_holm']:.2g}"]
    return [
        *names, str(row["seeds"]), millions(row["steps"]), of, interval_text(row["mean"], row["low"], row["high"], style),
        *tests, verdict_text(row, lambda value: format(value, style)), row["chosen"], printed,
        f"{row['largest_critic_loss']:.2g}", row["commit"],
    ]  # fmt: skip


def files() -> dict[Path, str]:
    """Return the tables as files, and the pages that show some of them."""
    rows = cells()
    groups = read_methods(run_folders(rows))
    claims = "\n\n".join(claims_text(number, groups) for number in (1, 2))
    tables = {"grid": grid.text(rows), "summary": grid.summary(rows)}
    return {
        RUNS / "cells.csv": csv_text(rows),
        RUNS / "cells.md": f"{cells_text(rows)}\n\n{table_text(comparisons_at_ages(groups))}\n",
        RUNS / "claims.md": f"{claims}\n",
        **pages_with(tables),
    }


def run_folders(rows: list[Row]) -> list[Path]:
    """Return the folders of the runs of cells."""
    return [RUNS / row["env"] / row["run"] for row in rows if row["seeds"]]


def draw() -> None:
    """Draw all cells, the deployed scores of each task, and the rewards of the life of some, over the released ones."""
    rows = [row for row in cells() if row["seeds"]]
    grid.draw(read_methods(run_folders(rows)), RUNS / "cells.png")
    for env in dict.fromkeys(row["env"] for row in rows):
        folders = [RUNS / env / row["run"] for row in rows if row["env"] == env]
        pictures = {"curves": RunFolder.open(folders[0]).config.deployed_metric}
        if env in LIVES:
            pictures["lives"] = "continuing/reward"
        for name, metric in pictures.items():
            picture = RUNS / env / f"{name}.png"
            shrink(plot_runs(folders, picture, metric=metric, size="page", smooth=10, published=True))


if __name__ == "__main__":
    write_files(files())
    draw()
