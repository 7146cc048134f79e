"""Redraw the tables, curves and figure 2 from the run folders in benchmarks/results/reproduce/runs.

    python -m benchmarks.redraw [--out DIR]

Figures 4 and 5 need checkpoints, which are not kept; their data are in figure4_visits.csv and figure5_seeds.csv.
"""

import argparse
from pathlib import Path

from earl_jax.paper.curves import write_curves
from earl_jax.paper.figure2 import write_figure2
from earl_jax.paper.reproduce import RESULTS
from earl_jax.paper.tables import write_table

KEPT = Path(__file__).parent / "results" / "reproduce"


def redraw(out: Path) -> list[Path]:
    """Return the files written into `out`, a folder for each table and figure."""
    runs = sorted(path.parent for path in KEPT.glob("runs/*/*/*/metrics.csv"))
    suite = [path for path in runs if path.parts[-3] in RESULTS["figure2"].tasks]
    tasks = [path for path in runs if path not in suite]
    written = [*write_table(1, tasks, out / "table1"), *write_table(2, tasks, out / "table2")]
    return [*written, *write_curves(tasks, out / "curves"), *write_figure2(suite, out / "figure2")]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=KEPT)
    for path in redraw(parser.parse_args().out):
        print(path)
