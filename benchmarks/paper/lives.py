"""The rewards of the life of the paper's cells against the released ones: `python -m benchmarks.paper.lives`.

Writes results/paper/lives.csv and lives.md: the tests of `earl-jax compare --against published --metric continuing/reward`, at
the last step that both sides have, p adjusted by Holm over the methods of a task. The paper has no such rewards of the oracle,
and those of R3L on the door are not tested (assets/published/faults.csv).
"""

from pathlib import Path

from benchmarks.output import csv_text, write_files
from benchmarks.paper.cells import LIVES, RUNS, comparisons_at_ages
from earl_jax.paper.artefact import methods_on
from earl_jax.report.comparison import table_text
from earl_jax.report.runs import read_methods

METRIC = "continuing/reward"


def files() -> dict[Path, str]:
    """Return the tests as files."""
    cells = [RUNS / env / algo for env in LIVES for algo in methods_on(env)]
    groups = read_methods([cell for cell in cells if (cell / "metrics.csv").is_file()])
    rows = [row for row in comparisons_at_ages(groups, METRIC) if row["age"] == 1.0]
    return {RUNS / "lives.csv": csv_text(rows), RUNS / "lives.md": f"{table_text(rows)}\n"}


if __name__ == "__main__":
    write_files(files())
