"""What cloning alone earns, deployed and in its life: `python -m benchmarks.paper.cloning`.

Reads the runs of results/cloning and writes results/cloning/table.csv and the table `cloning` of the pages.
"""

from pathlib import Path

import numpy as np

from benchmarks.output import RESULTS, pages_with, read_csv, write_files
from earl_jax.metrics.deployed import WIDE
from earl_jax.metrics.phase_stats import ALIVE, BACK, FORWARD
from earl_jax.report.runs import read
from earl_jax.report.scores import interval_of
from earl_jax.report.tables import csv_text, interval_text, markdown_table

RUNS = RESULTS / "cloning"
TASKS = "sawyer_peg", "sawyer_door", "tabletop_organization"
WHOLE = {"deployed": "deployed/success", "wide starts": WIDE}
"""Columns that are means over all evaluations of a seed."""
LIFE = {"forward": FORWARD, "return": BACK}
"""Columns that are the mean over seeds at the first and at the last evaluation."""


def rows() -> list[dict[str, str]]:
    """Return the table's rows; an interval is over seeds."""
    experts = {row["task"]: float(row["wide"]) for row in read_csv(RUNS / "experts.csv")}
    result = []
    for task in TASKS:
        run = read(RUNS / task)
        metrics = run.metrics
        scores = {name: metrics[metric].mean(axis=1) for name, metric in WHOLE.items()}
        row = {name: interval_text(*interval_of(run, score, WHOLE[name])) for name, score in scores.items()}
        for name, metric in LIFE.items():
            first, last = np.nanmean(metrics[metric], axis=0)[[0, -1]]
            row[name] = f"{first:.2f}, then {last:.2f}"
        alive = f"{metrics[ALIVE][:, -1].sum():.0f} of {run.seeds}"
        result.append({"task": task, **row, "alive": alive, "expert, wide": f"{experts[task]:.2f}"})
    return result


def files() -> dict[Path, str]:
    """Return the page with the table, and its rows as csv."""
    table = rows()
    text = markdown_table(list(table[0]), [list(row.values()) for row in table])
    return {RUNS / "table.csv": csv_text(table), **pages_with({"cloning": text})}


if __name__ == "__main__":
    write_files(files())
