"""The paper's 27 cells from the runs in results/paper: `python -m benchmarks.paper_cells`.

A cell is a task and a method, trained at the paper's settings. Its score is the mean over the evaluations of the last 100,000
steps. Runs of the published length are tested against the published score, as `earl-jax compare` does. Writes cells.csv,
cells.md, a figure of each task that was run, curves.png in its folder, and the tables between comments in docs/results.md and
README.md.
"""

import json
from pathlib import Path
from typing import Any

from benchmarks.output import RESULTS
from earl_jax.envs import PAPER_TASKS
from earl_jax.paper.artefact import METHODS, methods_on, training_steps
from earl_jax.report.comparison import RULE, published_rows, with_verdicts
from earl_jax.report.plots import plot_runs
from earl_jax.report.published import RECONSTRUCTED, published_score
from earl_jax.report.runs import read_methods
from earl_jax.report.tables import interval_text, markdown_table, millions, write
from earl_jax.runs.provenance import short_commit

ROOT = RESULTS / "paper"
TABLETOP, PEG = "tabletop_organization", "sawyer_peg"
FORMER_VAPRL = "no_nearest_fallback-no_unmet_goals"
"""Variant of runs of VaPRL with the defaults that it had until 2026-11-23."""
NOT_RUN = "not run"
START, END = "<!-- cells -->", "<!-- end of cells -->"
PAGES = ROOT.parents[2]
HEADER = (
    "task",
    "method",
    "seeds",
    "steps",
    "of",
    "mean [95 %]",
    "published",
    "difference [95 %]",
    "adjusted p",
    "verdict",
    "detectable",
    "largest critic loss",
    "commit",
)


def cells(root: Path = ROOT) -> list[dict[str, Any]]:
    """Return a row for each of the paper's cells, of which those without a run have a verdict only."""
    names = [(env, algo) for env in PAPER_TASKS for algo in methods_on(env, METHODS)]
    folders = {name: folder for name in names if (folder := _folder(root.joinpath(*name)))}
    runs = read_methods(list(folders.values()))
    tests = {(row["env"], row["first"]): row for row in with_verdicts(published_rows(runs))}
    measured: dict[tuple[str, str], dict[str, Any]] = {}
    for run in runs:
        folder = folders[run.env, run.algo]
        measured[run.env, run.algo] = {
            **tests[run.env, run.label],
            "run": folder.relative_to(root / run.env).as_posix(),
            "largest_critic_loss": float(run.curves.metrics["critic_loss"].max()),
            "commit": short_commit(commit_of(folder)),
        }
    return [_cell(*name, measured.get(name)) for name in names]


def _folder(cell: Path) -> Path | None:
    """Return the folder of the run of a cell, which is VaPRL's with its former defaults where it has no other; None without."""
    return next((folder for folder in (cell, cell / FORMER_VAPRL) if (folder / "metrics.csv").exists()), None)


def _cell(env: str, algo: str, measured: dict[str, Any] | None) -> dict[str, Any]:
    """Return the row of a cell from what was `measured`, None if it was not run."""
    score = None if env in RECONSTRUCTED else published_score("table1", env, algo)
    row = dict.fromkeys(("seeds", "steps", "mean", "low", "high", "difference", "difference_low", "difference_high"))
    row |= dict.fromkeys(("p", "p_holm", "detectable", "largest_critic_loss", "commit"))
    names = {
        "env": env,
        "algo": algo,
        "run": measured["run"] if measured else None,
        "of": training_steps(env),
        "published": score.text if score else None,
    }
    if measured is None:
        return {**names, **row, "verdict": NOT_RUN}
    row |= {name: measured[name] for name in ("seeds", "steps", "mean", "largest_critic_loss", "commit")}
    row |= {"low": measured["mean_low"], "high": measured["mean_high"]}
    row |= {name: measured[name] for name in ("difference", "p", "p_holm", "detectable", "verdict")}
    return {**names, **row, "difference_low": measured["low"], "difference_high": measured["high"]}


def commit_of(folder: Path) -> str:
    """Return the commit that made the run of `folder`."""
    return json.loads((folder / "config.json").read_text())["provenance"]["commit"]


def cells_text(rows: list[dict[str, Any]]) -> str:
    """Return the rows of `cells` as a markdown table."""
    return markdown_table(HEADER, [_line(row) for row in rows])


def _line(row: dict[str, Any]) -> list[str]:
    names = [row["env"], row["algo"] + (", former defaults" if row["run"] not in (None, row["algo"]) else "")]
    if row["seeds"] is None:
        return [*names, *"--", millions(row["of"]), "-", row["published"] or "-", *"--", row["verdict"], *"---"]
    tested = row["p"] is not None and row["p"] == row["p"]
    difference = interval_text(row["difference"], row["difference_low"], row["difference_high"]) if tested else "-"
    numbers = (
        [f"{row['p_holm']:.2g}", row["verdict"], f"{row['detectable']:.2g}"] if tested else ["-", row["verdict"], "-"]
    )
    return [
        *names, str(row["seeds"]), millions(row["steps"]), millions(row["of"]),
        interval_text(row["mean"], row["low"], row["high"]), row["published"] or "-", difference, *numbers,
        f"{row['largest_critic_loss']:.2g}", row["commit"],
    ]  # fmt: skip


def cells_summary(rows: list[dict[str, Any]]) -> str:
    """Return the rows of `cells` without the columns that docs/results.md has no room for."""
    return markdown_table(HEADER[:-3], [_line(row)[:-3] for row in rows])


def tested_summary(rows: list[dict[str, Any]]) -> str:
    """Return the tested ones of the rows of `cells`, for README.md."""
    lines = []
    for row in rows:
        if row["p"] is not None and row["p"] == row["p"]:
            ours, difference = (
                interval_text(row[name], row[f"{start}low"], row[f"{start}high"])
                for name, start in (("mean", ""), ("difference", "difference_"))
            )
            texts = [ours, row["published"], difference]
            lines.append([row["env"], row["algo"], str(row["seeds"]), *texts, f"{row['p_holm']:.2g}"])
    header = ["task", "method", "seeds", "success [95 %]", "published (s.e.)", "difference [95 %]", "adjusted p"]
    return markdown_table(header, lines)


def with_table(page: str, table: str, start: str = START, end: str = END) -> str:
    """Return the text of `page` with `table` between the comments `start` and `end` that mark its place."""
    before, _, rest = page.partition(start)
    _, _, after = rest.partition(end)
    return f"{before}{start}\n\n{table}\n\n{end}{after}"


def main() -> None:
    """Write the tables and figures."""
    rows = cells()
    write(rows, ROOT / "cells.csv")
    (ROOT / "cells.md").write_text(f"{cells_text(rows)}\n\n{RULE}\n")
    for env in dict.fromkeys(row["env"] for row in rows if row["seeds"]):
        runs = [ROOT / env / row["run"] for row in rows if row["env"] == env and row["seeds"]]
        plot_runs(runs, ROOT / env / "curves.png", smooth=10)
    for page, table in (
        (PAGES / "docs" / "results.md", cells_summary(rows)),
        (PAGES / "README.md", tested_summary(rows)),
    ):
        page.write_text(with_table(page.read_text(), table))
    print((ROOT / "cells.md").read_text())


if __name__ == "__main__":
    main()
