"""Figure 5 from the runs of tabletop in results/paper: success of final policies from uniform starts.

    python -m benchmarks.uniform_starts [--evaluate]

With --evaluate, the policies of every run of the published length run 100 episodes from each kind of start, and
results/starts/paper_seeds.csv is written: the task's own start, and gripper and mug anywhere within 2.5 (as the release
draws them) or within 2.8 (the whole table, `earl-jax evaluate --starts uniform`). Without it, only the table between
comments in docs/results.md is written, from that file.
"""

import argparse
import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from benchmarks.paper_cells import PAGES, ROOT, TABLETOP, commit_of, with_table
from benchmarks.starts import within
from earl_jax import assets
from earl_jax.metrics.comparison import mean_interval
from earl_jax.metrics.deployed import deployed
from earl_jax.metrics.robustness import relative_drop
from earl_jax.paper.tasks import training_steps
from earl_jax.report.runs import read
from earl_jax.report.tables import interval_text, markdown_table, write
from earl_jax.runs.folder import RunFolder
from earl_jax.training.loading import load_policies

SEEDS = Path(__file__).parent / "results" / "starts" / "paper_seeds.csv"
EPISODES = 100
KINDS = {"initial": None, "within_2.5": 2.5, "within_2.8": 2.8}
"""Kinds of starts by column: None is the task's own, else the largest coordinate of gripper and mug."""
RELEASED = "within_2.5"
MARKS = "<!-- starts -->", "<!-- end of starts -->"
HEADER = ("run", "seeds", "from s0 [95 %]", "within 2.5 [95 %]", "drop, % [95 %]", "published drop, %",
          "within 2.8 [95 %]", "drop, % [95 %]")  # fmt: skip

Row = dict[str, Any]


def evaluate(root: Path = ROOT / TABLETOP, steps: int | None = None, episodes: int = EPISODES) -> list[Row]:
    """Return a row for each seed of each run below `root` that has policies of step `steps`, by default the published."""
    length = training_steps(TABLETOP) if steps is None else steps
    folders = [file.parent for file in sorted(root.rglob("policies.npz"))]
    finished = [folder for folder in folders if int(read(folder).steps[-1]) == length]
    return [row for folder in finished for row in _run_rows(folder, folder.relative_to(root).as_posix(), episodes)]


def _run_rows(folder: Path, name: str, episodes: int) -> list[Row]:
    run = RunFolder.open(folder)
    env, policies = load_policies(run)
    columns: dict[str, np.ndarray] = {}
    for kind, limit in KINDS.items():
        start = env.reset if limit is None else within(env, limit)

        def success(policy, start=start):
            return deployed(env, policy, jax.random.key(0), env.eval_horizon, episodes, start)["deployed/success"]

        columns[kind] = np.asarray(jax.jit(jax.vmap(success))(policies), float).round(4)
    common = {"run": name, "commit": (commit_of(folder) or "")[:9]}
    return [
        {**common, "seed": seed, **{kind: float(values[lane]) for kind, values in columns.items()}}
        for lane, seed in enumerate(run.config.seeds)
    ]


def read_seeds(file: Path = SEEDS) -> dict[str, dict[str, np.ndarray]]:
    """Return the success [seeds] by run and kind of start in `file`."""
    with file.open() as handle:
        rows = list(csv.DictReader(handle))
    return {
        run: {kind: np.array([float(row[kind]) for row in rows if row["run"] == run]) for kind in KINDS}
        for run in dict.fromkeys(row["run"] for row in rows)
    }


def table(runs: dict[str, dict[str, np.ndarray]]) -> str:
    """Return the rows of `read_seeds` as a markdown table, beside the published drops of whole methods."""
    return markdown_table(HEADER, [_line(run, success) for run, success in runs.items()])


def _line(run: str, success: dict[str, np.ndarray]) -> Sequence[str]:
    own, (released, whole) = success["initial"], (success[kind] for kind in ("within_2.5", "within_2.8"))
    published = assets.published_row("figure5", algo=run).get("drop_percent", "-")
    texts = [interval_text(*mean_interval(scores)) for scores in (own, released, whole)]
    drops = ["{:.1f} [{:.1f}, {:.1f}]".format(*(100 * end for end in relative_drop(own, other)))
             for other in (released, whole)]  # fmt: skip
    return [run, str(len(own)), texts[0], texts[1], drops[0], published, texts[2], drops[1]]


def write_table() -> None:
    """Write the table in docs/results.md from the kept successes."""
    page = PAGES / "docs" / "results.md"
    page.write_text(with_table(page.read_text(), table(read_seeds()), *MARKS))


def main() -> None:
    """Evaluate if asked, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--evaluate", action="store_true", help="evaluate the policies again")
    if parser.parse_args().evaluate:
        write(evaluate(), SEEDS)
    write_table()
    print(table(read_seeds()))


if __name__ == "__main__":
    main()
