"""Join runs of the same cell, each of other seeds, into one: `python -m benchmarks.paper.join OUT RUN...`.

Half an hour of a GPU holds five million steps of the kitchen for one seed only, so that each seed of its cells is a run.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import tyro
from tyro.conf import Positional

from benchmarks.output import read_csv
from earl_jax.errors import InputError
from earl_jax.report.tables import csv_text
from earl_jax.runs.contents import CONFIG, METRICS

OWN = ("seeds", "id", "provenance")
"""Names in the config of a run in which the joined ones may differ; the joined run has those of the first, with all seeds."""


def joined(runs: Sequence[Path]) -> tuple[dict[str, Any], list[dict[str, str]]]:
    """Return the config and the rows of `runs` as one run, in the order of their seeds, up to the last step that all have.

    Raises:
        ValueError: the configs differ in more than `OWN`, or two runs have the same seed.
    """
    configs = [json.loads((run / CONFIG).read_text()) for run in runs]
    for run, config in zip(runs, configs, strict=True):
        differing = [name for name in {**configs[0], **config} if config.get(name) != configs[0].get(name)]
        if not set(differing) <= set(OWN):
            raise InputError(f"{run} and {runs[0]} differ in {', '.join(sorted({*differing} - {*OWN}))}")
    seeds = sorted(seed for config in configs for seed in config["seeds"])
    if len(set(seeds)) < len(seeds):
        raise InputError(f"a seed is in two of the runs: {seeds}")
    tables = [read_csv(run / METRICS) for run in runs]
    end = min(int(table[-1]["step"]) for table in tables)
    rows = [row for table in tables for row in table if int(row["step"]) <= end]
    rows.sort(key=lambda row: (int(row["step"]), int(row["seed"])))
    return configs[0] | {"seeds": seeds}, rows


def main(out: Positional[Path], runs: Positional[tuple[Path, ...]]) -> None:
    """Write the joined run to the folder `out`; those that it is made of stay."""
    config, rows = joined(runs)
    out.mkdir(parents=True, exist_ok=True)
    (out / CONFIG).write_text(json.dumps(config, indent=2) + "\n")
    (out / METRICS).write_text(csv_text(rows))


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
