"""Compute the GPU-hours of the whole paper from measured rates: `python -m benchmarks.speed.budget --rates FILE.csv ...`.

The paper's cells are its tasks and the methods that can run on them, each with five seeds in one program, at the published
number of steps. FILE.csv comes from benchmarks.speed.per_device. `hours_in_turn` is the time of the cells of a task one after
the other, each at the rate of its method alone; a method without a rate takes the time of the mean of the others.
`hours` divides it by `gain`, the largest measured gain of several programs at once with the same methods, if it is above one.
Evaluations, compilation and starts are not counted: add `--overhead`, the share of a run's time that they take. Prints the
table; writes OUT.json and OUT.csv.
"""

from collections.abc import Sequence
from pathlib import Path

import tyro

from benchmarks.output import RESULTS, read_csv, save_rows
from earl_jax.envs import PAPER_TASKS
from earl_jax.paper.artefact import methods_on
from earl_jax.report.published import training_steps
from earl_jax.report.tables import Row, markdown_table


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
        raise ValueError(
            f"no rate of one program on {env}; run python -m benchmarks.speed.per_device --cases {env}:fbrl:1"
        )
    methods, steps = methods_on(env), training_steps(env)
    mean = sum(alone.values()) / len(alone)
    seconds = steps * sum(alone.get(method, mean) for method in methods) / (1 - overhead)
    best = max(rates, key=lambda rate: float(rate["wall_gain"]))
    return {
        "task": env, "cells": len(methods), "steps": steps, "alone": round(1 / mean),
        "hours_in_turn": round(seconds / 3600, 2), "programs": int(best["programs"]), "gain": float(best["wall_gain"]),
        "hours": round(seconds / 3600 / float(best["wall_gain"]), 2),
    }  # fmt: skip


def main(
    rates: tuple[Path, ...] = tuple(sorted((RESULTS / "per_device").glob("*.csv"))),
    overhead: float = 0.0,
    out: Path = RESULTS / "budget" / "h200",
) -> None:
    """Print and write the table; `overhead` is the share of a run's time that is no training."""
    rows = budget([row for path in rates for row in read_csv(path)], overhead)
    print(markdown_table(list(rows[0]), [[row.get(name, "") for name in rows[0]] for row in rows]))
    save_rows(out, rows)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
