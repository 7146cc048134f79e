"""Redraw the tables, curves and figures from the data in benchmarks/results/reproduce.

    python -m benchmarks.redraw [--out DIR]

Tables, curves and figure 2 are made of the folders in runs, figure 4 of figure4.csv and figure4_visits.csv, figure 5 of
figure5_seeds.csv.
"""

import argparse
import csv
from pathlib import Path

from earl_jax.paper.curves import write_curves
from earl_jax.paper.figure2 import write_figure2
from earl_jax.paper.figure4 import draw_figure4
from earl_jax.paper.figure5 import write_figure5
from earl_jax.paper.reproduce import RESULTS
from earl_jax.paper.tables import write_table
from earl_jax.paper.visit_maps import read_maps

KEPT = Path(__file__).parent / "results" / "reproduce"


def redraw(out: Path) -> list[Path]:
    """Return the files written into `out`, a folder for each table and figure."""
    runs = sorted(path.parent for path in KEPT.glob("runs/*/*/*/metrics.csv"))
    suite = [path for path in runs if path.parts[-3] in RESULTS["figure2"].tasks]
    tasks = [path for path in runs if path not in suite]
    written = [*write_table(1, tasks, out / "table1"), *write_table(2, tasks, out / "table2")]
    written += [*write_curves(tasks, out / "curves"), *write_figure2(suite, out / "figure2")]
    written += draw_figure4(read_maps(KEPT / "figure4"), out / "figure4")
    with (KEPT / "figure5" / "figure5_seeds.csv").open() as handle:
        return [*written, *write_figure5(list(csv.DictReader(handle)), out / "figure5")]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=KEPT)
    for path in redraw(parser.parse_args().out):
        print(path)
