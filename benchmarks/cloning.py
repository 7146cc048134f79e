"""What cloning the demonstrations alone earns: `python -m benchmarks.cloning` (some minutes on two cores).

Runs `bc` on the sparse tasks: actors cloned from the demonstrations of both directions before the first step, then a
life without learning. Deployed success, from the ordinary starts and from wide ones, is that of the cloned policy at
every evaluation. Writes config.json and metrics.csv of each run into results/cloning, and the table of docs/formalism.md.
With `--table` it writes the table alone. experts.csv has the scripted experts' success, as a ceiling for wide starts.
"""

import csv
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

import jax
import numpy as np

import earl_jax
from benchmarks.paper_cells import PAGES, with_table
from earl_jax.envs import make
from earl_jax.metrics.comparison import mean_interval
from earl_jax.metrics.deployed import WIDE, deployed
from earl_jax.metrics.life import ALIVE, BACK, FORWARD
from earl_jax.report.runs import Curves, read
from earl_jax.report.tables import interval_text, markdown_table, write

ROOT = Path(__file__).parent / "results" / "cloning"
PAGE = PAGES / "docs" / "formalism.md"
MARKS = "<!-- cloning -->", "<!-- end of cloning -->"
TASKS = ("sawyer_peg", "sawyer_door", "tabletop_organization")
RUN: dict[str, Any] = {"seeds": 5, "steps": 10_000, "eval_every": 2_000, "eval_episodes": 20}
EPISODES = 200
EXPERTS = ROOT / "experts.csv"
HEADER = (
    "task",
    "deployed",
    "from wide starts",
    "forward",
    "way back",
    "C(A)",
    "seeds alive at the end",
    "expert, wide",
)


def run(task: str) -> None:
    """Train `bc` on `task` and keep its config and metrics."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "run"
        earl_jax.train(task, "bc", out=folder, **RUN)
        (ROOT / task).mkdir(parents=True, exist_ok=True)
        for name in ("config.json", "metrics.csv"):
            shutil.copyfile(folder / name, ROOT / task / name)


def run_experts() -> None:
    """Write the success of each task's scripted expert."""
    rows = []
    for task in TASKS:
        env = make(task).for_lanes(2 * EPISODES)
        scores = jax.jit(
            lambda key, env=env: deployed(env, env.expert, key, env.eval_horizon, EPISODES, wide=env.reset_wide)
        )
        values = scores(jax.random.key(0))
        rows.append(
            {
                "task": task,
                "episodes": EPISODES,
                "initial": float(values["deployed/success"]),
                "wide": float(values[WIDE]),
            }
        )
    write(rows, EXPERTS)


def table() -> str:
    """Return the table of the runs in results/cloning."""
    with EXPERTS.open(newline="") as handle:
        experts = {row["task"]: f"{float(row['wide']):.2f}" for row in csv.DictReader(handle)}
    return markdown_table(HEADER, [[*line(task, read(ROOT / task)), experts[task]] for task in TASKS])


def line(task: str, curves: Curves) -> list[str]:
    """Return the texts of one row of the table."""
    scores = [curves.metrics[name].mean(axis=1) for name in (curves.deployed_metric, WIDE)]
    first, last = ([float(np.nanmean(curves.metrics[name][:, at])) for name in (FORWARD, BACK)] for at in (0, -1))
    texts = [interval_text(*mean_interval(values)) for values in scores]
    texts += [f"{start:.2f}, then {end:.2f}" for start, end in zip(first, last, strict=True)]
    texts.append(f"{curves.metrics['continuing/reward'][:, -1].mean():.4f}")
    alive = curves.metrics[ALIVE][:, -1]
    return [task, *texts, f"{int(alive.sum())} of {len(alive)}"]


def main() -> None:
    """Run what was not run yet, and write the table."""
    for task in TASKS:
        if "--table" not in sys.argv and not (ROOT / task / "metrics.csv").exists():
            run(task)
            print(*line(task, read(ROOT / task)), flush=True)
    if not EXPERTS.exists():
        run_experts()
    if MARKS[0] in PAGE.read_text():
        PAGE.write_text(with_table(PAGE.read_text(), table(), *MARKS))


if __name__ == "__main__":
    main()
