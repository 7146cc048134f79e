"""Redraw all tables and figures from the committed data, and the tables of the pages.

    python -m benchmarks.redraw [--out DIR]

Figure 2 and the trade-off are made of run folders below benchmarks/results/reproduce, figure 3 of the paper's cells. With
--out, only these are written, into another folder. The other files are those that the modules of benchmarks.paper and
benchmarks.speed.method_cost write.
"""

from pathlib import Path

import tyro

from benchmarks.output import RESULTS, shrink, write_files
from benchmarks.paper import cells, differences, leaderboard, lives, uniform_starts
from benchmarks.speed import method_cost
from earl_jax.paper import figure3
from earl_jax.paper.artefact import Report
from earl_jax.paper.reproduce import ARTEFACTS

KEPT = RESULTS / "reproduce"
PAGES = (cells, differences, lives, uniform_starts, leaderboard, method_cost)
"""The modules that write tables into pages."""


def reports() -> dict[str, Report]:
    """Return the report of every figure, from the kept data."""
    runs = {"figure2": KEPT / "runs", "tradeoff": KEPT / "tradeoff" / "runs"}
    folders = {name: sorted(path.parent for path in root.glob("*/*/*/metrics.csv")) for name, root in runs.items()}
    folders["figure3"] = [cells.RUNS / env / algo for env in figure3.TASKS for algo in figure3.METHODS]
    drawn = {name: ARTEFACTS[name].report(of_runs) for name, of_runs in folders.items()}
    del drawn["figure3"].tables["_visits"]  # a row for each bin, which the maps of the cells have
    return drawn


def redraw(out: Path) -> list[Path]:
    """Return the files written into `out`, a folder for each figure."""
    written = [path for name, report in reports().items() for path in report.write(name, out / name)]
    for path in written:
        if path.suffix == ".png":
            shrink(path)
    return written


def main(out: Path = KEPT) -> None:
    """Write everything, or into another folder `out` than results/reproduce what `redraw` makes."""
    print(*redraw(out), sep="\n")
    if out == KEPT:
        for module in PAGES:
            write_files(module.files())
        for module in (cells, differences):
            module.draw()


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
