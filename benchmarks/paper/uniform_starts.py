"""Figure 4 from the runs of tabletop in results/paper: success of final policies from uniform starts.

    python -m benchmarks.paper.uniform_starts [--evaluate]

With --evaluate, the policies of every run of the published length that results/starts/paper_seeds.csv lacks run 100 episodes
from each kind of start, and their success is added to it. Starts are the task's own, gripper and mug anywhere within 2.5 (as
the release draws them), or within 2.8 (the whole table, `earl-jax evaluate --starts uniform`). Without it, only the table
between comments in docs/results.md is written, from that file.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated

import jax
import jax.numpy as jnp
import numpy as np
import tyro

from benchmarks.output import RESULTS, pages_with, read_csv, write_files
from benchmarks.paper.cells import RUNS, TABLETOP
from earl_jax import assets
from earl_jax.envs import Env, State
from earl_jax.envs.tabletop import FREE
from earl_jax.metrics.comparison import mean_interval
from earl_jax.metrics.deployed import deployed
from earl_jax.metrics.statistics import relative_drop
from earl_jax.physics import PhysicsState
from earl_jax.report.leaderboard import commit_of
from earl_jax.report.published import training_steps
from earl_jax.report.runs import read
from earl_jax.report.tables import Row, csv_text, interval_text, markdown_table
from earl_jax.runs.folder import RunFolder
from earl_jax.runs.provenance import short_commit
from earl_jax.training.loading import load_policies

SEEDS = RESULTS / "starts" / "paper_seeds.csv"
EPISODES = 100
KINDS = {"initial": None, "within_2.5": 2.5, "within_2.8": 2.8}
"""Kinds of starts by column: None is the task's own, else the largest coordinate of gripper and mug."""
RELEASED = "within_2.5"
HEADER = ("run", "seeds", "from s0 [95 %]", "within 2.5 [95 %]", "drop, % [95 %]", "published drop, %",
          "within 2.8 [95 %]", "drop, % [95 %]")  # fmt: skip


def within(env: Env, limit: float) -> Callable[[jax.Array], State]:
    """Return the starts of `env` with gripper and mug uniform in ±`limit`, and any task goal."""

    def start(key):
        position_key, goal_key = jax.random.split(key)
        qpos, state = jax.random.uniform(position_key, (4,), minval=-limit, maxval=limit), env.reset(key)
        obs = jnp.concatenate([qpos, FREE, state.info["goal"]])
        return env.with_goal(state.replace(data=PhysicsState.at(qpos), obs=obs), env.sample_goal(goal_key))

    return start


def evaluate(root: Path = RUNS / TABLETOP, episodes: int = EPISODES, known: Sequence[Row] = ()) -> list[Row]:
    """Return the `known` rows, and one for each seed of each other run of the published length with policies below `root`.

    The repository keeps no policies of these runs, so the rows of known ones cannot be computed from it again.
    """
    length, rows = training_steps(TABLETOP), list(known)
    for folder in sorted(file.parent for file in root.rglob("policies.npz")):
        curves = read(folder)
        run = {"run": folder.relative_to(root).as_posix(), "commit": short_commit(commit_of(curves))}
        if curves.length == length and not any(run.items() <= row.items() for row in known):
            rows = [row for row in rows if row["run"] != run["run"]]
            rows += [{**run, **row} for row in _run_rows(folder, episodes)]
    return rows


def _run_rows(folder: Path, episodes: int) -> list[Row]:
    run = RunFolder.open(folder)
    env, policies = run.config.build_task(), load_policies(run)
    columns: dict[str, np.ndarray] = {}
    for kind, limit in KINDS.items():
        start = env.reset if limit is None else within(env, limit)

        def success(policy, start=start):
            return deployed(env, policy, jax.random.key(0), env.eval_horizon, episodes, start)["deployed/success"]

        columns[kind] = np.asarray(jax.jit(jax.vmap(success))(policies), float).round(4)
    return [
        {"seed": seed, **{kind: float(values[lane]) for kind, values in columns.items()}}
        for lane, seed in enumerate(run.config.seeds)
    ]


def read_seeds(file: Path = SEEDS) -> dict[str, dict[str, np.ndarray]]:
    """Return the success [seeds] by run and kind of start from the rows of `evaluate` in `file`."""
    rows = read_csv(file)
    return {
        run: {kind: np.array([float(row[kind]) for row in rows if row["run"] == run]) for kind in KINDS}
        for run in dict.fromkeys(row["run"] for row in rows)
    }


def table(runs: dict[str, dict[str, np.ndarray]]) -> str:
    """Return the rows of `read_seeds` as a markdown table, beside the published drops of whole methods."""
    return markdown_table(HEADER, [_line(run, success) for run, success in sorted(runs.items())])


def _line(run: str, success: dict[str, np.ndarray]) -> Sequence[str]:
    own, (released, whole) = success["initial"], (success[kind] for kind in ("within_2.5", "within_2.8"))
    published = assets.published_row("figure4", algo=run.partition("/")[0]).get("drop_percent", "-")
    texts = [interval_text(*mean_interval(scores, rate=True)) for scores in (own, released, whole)]
    drops = [interval_text(*(100 * end for end in relative_drop(own, other)), ".1f") for other in (released, whole)]
    return [run, str(len(own)), texts[0], texts[1], drops[0], published, texts[2], drops[1]]


def files() -> dict[Path, str]:
    """Return the page with the table of the kept successes."""
    return pages_with({"starts": table(read_seeds())})


def main(new: Annotated[bool, tyro.conf.arg(name="evaluate")] = False) -> None:
    """Evaluate the runs that are not in the file if asked, and write the table."""
    if new:
        SEEDS.write_text(csv_text(evaluate(known=read_csv(SEEDS))))
    write_files(files())


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
