"""Redraw all tables, curves and figures from the committed data, and the tables of README, docs/results.md and the leaderboard.

    python -m benchmarks.redraw [--out DIR]

Tables, curves, figure 2 and the trade-off are made of run folders below benchmarks/results/reproduce, figure 5 of
figure5_seeds.csv. With --out, only these are written, into another folder. The 27 cells, the tests of differences and the
leaderboard come from benchmarks/results/paper, as `python -m benchmarks.paper_cells`, `benchmarks.differences` and
`benchmarks.leaderboard` write them, and success from uniform starts from results/starts. The tables and the picture of
docs/cfbrl.md are those of `benchmarks.cfbrl`, the rates in docs/algorithms.md those of `benchmarks.speed.method_cost`.
"""

import argparse
import csv
from pathlib import Path

from benchmarks import cfbrl, differences, leaderboard, paper_cells
from benchmarks.output import RESULTS
from benchmarks.robustness import uniform_starts
from benchmarks.speed import method_cost
from earl_jax.paper import figure5
from earl_jax.paper.reproduce import ARTEFACTS

KEPT = RESULTS / "reproduce"


def redraw(out: Path) -> list[Path]:
    """Return the files written into `out`, a folder for each table and figure."""
    runs = sorted(path.parent for path in KEPT.glob("runs/*/*/*/metrics.csv"))
    suite = [path for path in runs if path.parts[-3] in ARTEFACTS["figure2"].tasks]
    tasks = [path for path in runs if path not in suite]
    tradeoff = sorted(path.parent for path in KEPT.glob("tradeoff/runs/*/*/*/metrics.csv"))
    folders = {"table1": tasks, "table2": tasks, "curves": tasks, "figure2": suite, "tradeoff": tradeoff}
    written = [path for name, made in folders.items() for path in ARTEFACTS[name].write(made, out / name)]
    with (KEPT / "figure5" / "figure5_seeds.csv").open() as handle:
        return [*written, *figure5.report_of(list(csv.DictReader(handle))).write("figure5", out / "figure5")]


def main() -> None:
    """Write everything, or with --out, what `redraw` makes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="other folder than benchmarks/results/reproduce")
    out = parser.parse_args().out
    print(*redraw(out or KEPT), sep="\n")
    if out is None:
        paper_cells.main()
        differences.main()
        uniform_starts.write_table()
        leaderboard.write_page()
        cfbrl.main()
        method_cost.write_tables()


if __name__ == "__main__":
    main()
