"""Compute the GPU-hours of the whole paper from measured rates: `python -m benchmarks.budget --rates FILE.csv ... --out FILE`.

The paper's cells are its tasks and the methods that can run on them, each with five seeds in one program, at the published
number of steps. FILE.csv comes from `python -m benchmarks.per_device`. `hours_in_turn` is the time of the cells of a task one
after the other, each at the rate of its method alone; a method without a rate takes the time of the mean of the others.
`hours` divides it by `gain`, the largest measured gain of several programs at once with the same methods, if it is above one.
Evaluations, compilation and starts are not counted: add `--overhead`, the share of a run's time that they take. Prints the
table; writes FILE.json and FILE.csv.
"""

import argparse
import csv
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from benchmarks.output import save
from earl_jax.envs import PAPER_TASKS
from earl_jax.paper.artefact import METHODS, methods_on, training_steps
from earl_jax.report.tables import markdown_table, write

Row = dict[str, Any]


def read_rates(paths: Iterable[Path]) -> list[Row]:
    """Return the rows of all files of rates."""
    return [row for path in paths for row in csv.DictReader(path.open())]


def budget(rates: Sequence[Row], overhead: float = 0.0) -> list[Row]:
    """Return a row for each of the paper's tasks, and their sum; hours are of one GPU.

    Raises:
        ValueError: a task has no rate of a single program.
    """
    rows = [_row(env, [rate for rate in rates if rate["env"] == env], overhead) for env in PAPER_TASKS]
    total = {"task": "all", "cells": sum(row["cells"] for row in rows)}
    for column in ("hours_in_turn", "hours"):
        total[column] = round(sum(row[column] for row in rows), 2)
    return [*rows, total]


def _row(env: str, rates: Sequence[Row], overhead: float) -> Row:
    alone = {rate["algos"]: 1 / float(rate["steps_per_s_total"]) for rate in rates if int(rate["programs"]) == 1}
    if not alone:
        raise ValueError(f"no rate of one program on {env}; run python -m benchmarks.per_device --cases {env}:fbrl:1")
    methods, steps = methods_on(env, METHODS), training_steps(env)
    mean = sum(alone.values()) / len(alone)
    seconds = steps * sum(alone.get(method, mean) for method in methods) / (1 - overhead)
    best = max(rates, key=lambda rate: float(rate["wall_gain"]))
    return {
        "task": env, "cells": len(methods), "steps": steps, "alone": round(1 / mean),
        "hours_in_turn": round(seconds / 3600, 2), "programs": int(best["programs"]), "gain": float(best["wall_gain"]),
        "hours": round(seconds / 3600 / float(best["wall_gain"]), 2),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--rates", nargs="+", type=Path, default=sorted(Path("benchmarks/results/per_device").glob("*.csv"))
    )
    parser.add_argument("--overhead", type=float, default=0.0, help="share of a run's time that is no training")
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/budget/h200"))
    options = parser.parse_args()
    rows = budget(read_rates(options.rates), options.overhead)
    columns = list(rows[0])
    table = [{column: row.get(column, "") for column in columns} for row in rows]
    print(markdown_table(columns, [list(row.values()) for row in table]))
    files = " ".join(str(path) for path in options.rates)
    save(
        options.out.with_suffix(".json"),
        f"python -m benchmarks.budget --rates {files} --overhead {options.overhead}",
        {"rows": rows},
    )
    write(table, options.out.with_suffix(".csv"))


if __name__ == "__main__":
    main()
