"""Redraw all tables and figures from the committed data, and the tables of the pages.

    python -m benchmarks.redraw [--out DIR]

Figure 2 and the trade-off are made of run folders below benchmarks/results/reproduce, figure 3 of the paper's cells and of
figure3_visits.npz. With --out, only these are written, into another folder. The other files are those that the modules of
benchmarks.paper and benchmarks.speed.method_cost write.
"""

from pathlib import Path

import numpy as np
import tyro

from benchmarks.output import RESULTS, shrink, write_files
from benchmarks.paper import cells, cfbrl, cloning, differences, leaderboard, learners, lives, uniform_starts
from benchmarks.speed import method_cost
from earl_jax.envs import make
from earl_jax.paper import figure3
from earl_jax.paper.artefact import Report
from earl_jax.paper.reproduce import ARTEFACTS

KEPT = RESULTS / "reproduce"
PAGES = (cells, differences, lives, uniform_starts, leaderboard, cfbrl, cloning, learners, method_cost)
"""The modules that write tables into pages."""
SUMS = (
    "The maps of tabletop are sums over five seeds, because earlier versions kept no others: a line counts them as one seed, "
    "and no difference is tested."
)


def reports() -> dict[str, Report]:
    """Return the report of every figure, from the kept data."""
    runs = {"figure2": KEPT / "runs", "tradeoff": KEPT / "tradeoff" / "runs"}
    folders = {name: sorted(path.parent for path in root.glob("*/*/*/metrics.csv")) for name, root in runs.items()}
    return {name: ARTEFACTS[name].report(of_runs) for name, of_runs in folders.items()} | {"figure3": visits()}


def redraw(out: Path) -> list[Path]:
    """Return the files written into `out`, a folder for each figure."""
    written = [path for name, report in reports().items() for path in report.write(name, out / name)]
    for path in written:
        if path.suffix == ".png":
            shrink(path)
    return written


def visits() -> Report:
    """Return figure 3 from the maps of cells and the kept sums over seeds, without a row for each bin."""
    with np.load(KEPT / "figure3" / "figure3_visits.npz") as kept:
        named = {tuple(name.split("/")): kept[name] for name in kept.files}
    sums = [figure3.VisitMap(env, make(env).map, algo, summed[None]) for (env, algo), summed in named.items()]
    own = [cells.RUNS / env / algo for env in figure3.TASKS for algo in figure3.METHODS if (env, algo) not in named]
    report = figure3.report_of([*sums, *figure3.read_maps(own)])
    parts = {**report.parts, "missing": "\n\n".join(filter(None, (SUMS, report.parts["missing"])))}
    return report._replace(parts=parts, tables={"": report.tables[""]})


def main(out: Path = KEPT) -> None:
    """Write everything, or into another folder `out` than results/reproduce what `redraw` makes."""
    print(*redraw(out), sep="\n")
    if out == KEPT:
        for module in PAGES:
            write_files(module.files())
        for module in (cells, differences, cfbrl, learners):
            module.draw()


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
