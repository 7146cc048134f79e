"""The published rows of the leaderboard: the paper's table 1, and what newer papers released (assets/published/newer.csv)."""

import math

from scipy import stats

from earl_jax import assets
from earl_jax.envs import PAPER_TASKS
from earl_jax.paper.artefact import METHODS, methods_on
from earl_jax.report.leaderboard import Row, score_text
from earl_jax.report.published import RECONSTRUCTED, SEEDS, published_crossings, published_score, published_steps
from earl_jax.report.tables import millions

PAPER = "EARL, 2022"


def published_rows() -> list[Row]:
    """Return the rows of the paper and those of newer papers, without those of a task that is our reconstruction."""
    cells = [(env, algo) for env in PAPER_TASKS if env not in RECONSTRUCTED for algo in methods_on(env, METHODS)]
    rows = [
        _paper_row(env, algo) for env, algo in cells if (score := published_score("table1", env, algo)) and score.sample
    ]
    return rows + [_newer_row(row) for row in assets.published("newer")]


def _paper_row(env: str, algo: str) -> Row:
    score, rewards = published_score("table1", env, algo), published_score("table2", env, algo)
    assert score is not None
    crossings = published_crossings(env, algo)
    low, high = score.interval or (math.nan, math.nan)
    return Row(
        env=env,
        method=algo,
        source=PAPER,
        seeds=SEEDS,
        steps=(published_steps(env) or (0, 0))[0],
        deployed=score_text(env, score.value, low, high),
        wide="-",
        continuing=rewards.text if rewards and rewards.mean not in ("-", "") else "-",
        alive="-",
        crossings=tuple(millions(crossings.get(level)) for level in (0.5, 0.9)),
        commit="-",
        score=score.value,
    )


def _newer_row(row: dict[str, str]) -> Row:
    """Return a row of newer.csv, whose standard errors divide the population's deviation by sqrt(n)."""
    mean, seeds = float(row["mean"]), int(row["seeds"])
    half = math.nan
    if row["stderr"]:
        half = float(stats.t.ppf(0.975, seeds - 1)) * float(row["stderr"]) * math.sqrt(seeds / (seeds - 1))
    return Row(
        env=row["env"],
        method=row["method"],
        source=f"{row['source']}, {row['year']}",
        seeds=seeds,
        steps=int(row["steps"]),
        deployed=score_text(row["env"], mean, mean - half, mean + half),
        wide="-",
        continuing="-",
        alive="-",
        crossings=tuple(millions(float(row[f"steps_to_{level}"] or "nan")) for level in (0.5, 0.9)),
        commit="-",
        score=mean,
    )
