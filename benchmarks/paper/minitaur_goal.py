"""What agents of the Minitaur earn until they first reach their goal: `python -m benchmarks.paper.minitaur_goal RUN...`.

Released episodes do not end there, but the printed score of the oracle looks as if they did. Each RUN, a folder with
policies.npz, is evaluated in its task. Writes results/minitaur/until_goal.csv, a row for each seed, and until_goal_tests.csv,
which tests the return until the goal, of the episodes that reach it, against the printed score.
"""

import math
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from tyro.conf import Positional

from benchmarks.output import RESULTS, save_rows
from earl_jax.envs import Env, State
from earl_jax.metrics.comparison import mean_interval
from earl_jax.report.comparison import comparison_columns
from earl_jax.report.published import published_score
from earl_jax.runs.folder import RunFolder
from earl_jax.training import Policy
from earl_jax.training.loading import load_policies

FALLEN = 0.5
"""Cosine between the body's up axis and the vertical below which a robot counts as fallen."""


class Episode(NamedTuple):
    """An episode: the `returns []` of its horizon and those `until_goal []`, its `steps []` until then, and two flags."""

    returns: jax.Array
    until_goal: jax.Array
    steps: jax.Array
    reached: jax.Array
    fallen: jax.Array


def play(env: Env, policy: Policy, key: jax.Array) -> Episode:
    """Return one episode of `policy` from s0 ~ rho."""

    def step(carry: tuple[State, Episode], _: None) -> tuple[tuple[State, Episode], None]:
        state, episode = carry
        state = env.step(state, policy(state.obs))
        before = ~episode.reached
        x, y = state.obs[24:26]
        episode = Episode(
            returns=episode.returns + state.reward,
            until_goal=episode.until_goal + before * state.reward,
            steps=episode.steps + before,
            reached=episode.reached | env.success(state.obs),
            fallen=1.0 - 2.0 * (x**2 + y**2) < FALLEN,
        )
        return (state, episode), None

    zero, no = jnp.zeros(()), jnp.zeros((), bool)
    start = Episode(zero, zero, jnp.zeros((), jnp.int32), no, no)
    return jax.lax.scan(step, (env.reset(key), start), length=env.eval_horizon)[0][1]


def rows_of(folder: RunFolder, episodes: int) -> list[dict[str, Any]]:
    """Return a row for each seed of a run: means over all episodes, and over those that reached their goal; nan for none."""
    env, policies = folder.config.build_task(), load_policies(folder)
    keys = jax.random.split(jax.random.key(0), episodes)
    played = jax.jit(jax.vmap(lambda policy: jax.vmap(lambda key: play(env, policy, key))(keys)))(policies)
    rows = []
    for seed, *values in zip(folder.config.seeds, *map(np.asarray, played), strict=True):
        of = Episode(*values)
        some = of.reached.any()
        rows.append({
            "algo": folder.config.algo, "seed": seed, "episodes": episodes, "step": folder.table().step,
            "return": of.returns.mean(), "reached": of.reached.mean(), "fallen at the end": of.fallen.mean(),
            "until goal": of.until_goal[of.reached].mean() if some else math.nan,
            "steps to goal": np.median(of.steps[of.reached]) if some else math.nan,
        })  # fmt: skip
    return rows


def test_of(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return Welch's test of the seeds of one method, given as their `rows`, against the printed score.

    It is nan if a seed never reached the goal.
    """
    scores = np.array([row["until goal"] for row in rows])
    score = published_score("table1", "minitaur_pen", rows[0]["algo"])
    printed = score and score.sample
    assert printed is not None
    test = comparison_columns(scores, printed)
    mean, low, high = mean_interval(scores)
    shares = {name: float(np.mean([row[name] for row in rows])) for name in ("reached", "fallen at the end")}
    return {
        "algo": rows[0]["algo"], "seeds": len(rows), **shares, "until goal": mean, "low": low, "high": high,
        "printed": test["other_mean"], "p": test["p"], "would be found": test["detectable"],
    }  # fmt: skip


def rounded(row: dict[str, Any]) -> dict[str, Any]:
    return {
        name: round(float(value), 3) if isinstance(value, float | np.floating) else value for name, value in row.items()
    }


def main(runs: Positional[tuple[Path, ...]], episodes: int = 100) -> None:
    """Evaluate the policies of each run in `episodes` episodes a seed."""
    by_run = [rows_of(RunFolder.open(run), episodes) for run in runs]
    path = RESULTS / "minitaur" / "until_goal"
    save_rows(path, [rounded(row) for rows in by_run for row in rows])
    save_rows(path.with_name("until_goal_tests"), [rounded(test_of(rows)) for rows in by_run])


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
