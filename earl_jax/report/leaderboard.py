"""The rows of the leaderboard: those that ship (assets/published/leaderboard.csv), and the row of any run beside them.

The file has the published scores and the runs of this repository; `python -m benchmarks.paper.leaderboard` writes it and
docs/leaderboard.md from the same rows.
"""

from collections.abc import Iterable

from earl_jax import assets
from earl_jax.envs import make
from earl_jax.metrics.deployed import WIDE
from earl_jax.metrics.phase_stats import ALIVE
from earl_jax.metrics.scores import CONTINUING, DEFAULT
from earl_jax.report.published import chosen_words
from earl_jax.report.runs import Curves
from earl_jax.report.scores import LEVELS, interval_of, level_crossings, seed_scores
from earl_jax.report.style import grouped
from earl_jax.report.tables import Row, interval_text, millions, step_interval
from earl_jax.runs.provenance import made_by, short_commit

TABLE = "leaderboard"
OURS = "earl_jax"
COLUMNS = {
    "method": "method", "source": "from", "seeds": "seeds", "steps": "steps", "deployed": "deployed [95 %]",
    "wide": "wide [95 %]", "continuing": "C(A) [95 %]", "alive": "alive",
    **{f"to_{level}": f"to {level}" for level in LEVELS}, "chosen": "chosen", "commit": "commit",
}  # fmt: skip
"""The headings of the columns. A row has these, `env`, and `score`, the mean deployed score to six digits; the values of
seeds, steps and score are numbers, all others texts, `-` for what a row does not have."""


def texts(row: Row) -> list[str]:
    """Return the cells of the table, in the order of `COLUMNS`."""
    return [millions(row[name]) if name == "steps" else str(row[name]) for name in COLUMNS]


def shipped_rows() -> list[Row]:
    """Return the rows that ship, of all tasks."""
    kinds = {"seeds": int, "steps": int, "score": float}
    return [{name: kinds.get(name, str)(text) for name, text in row.items()} for row in assets.published(TABLE)]


def ranked(rows: Iterable[Row]) -> dict[str, list[Row]]:
    """Return `rows` by task, in the order in which tasks occur, those of a task by their score, highest first."""
    by_task = grouped(rows, lambda row: row["env"])
    return {env: sorted(members, key=lambda row: -row["score"]) for env, members in by_task.items()}


def run_row(curves: Curves, source: str = OURS) -> Row:
    """Return the row of a run: scores by the default `Window`, each with its 95 % interval over seeds."""
    curves = curves._replace(window=DEFAULT)
    deployed, wide = (_score(curves, metric) for metric in (curves.deployed_metric, WIDE))
    alive = f"{curves.metrics[ALIVE][:, -1].mean():.0%}" if ALIVE in curves.metrics else "-"
    return {
        "env": curves.env,
        "method": curves.label,
        "source": source,
        "seeds": curves.seeds,
        "steps": curves.length,
        "deployed": deployed,
        "wide": wide,
        "continuing": interval_text(*interval_of(curves, curves.metrics[CONTINUING][:, -1], CONTINUING)),
        "alive": alive,
        **crossing_texts(curves),
        "chosen": chosen_words(curves),
        "commit": short_commit(commit_of(curves)) or "-",
        "score": round(float(seed_scores(curves).mean()), 6),
    }


def crossing_texts(curves: Curves) -> dict[str, str]:
    """Return the cells of a row that say when the runs reach each of `LEVELS`."""
    return {f"to_{level}": step_interval(*step) for level, step in level_crossings(curves).items()}


def commit_of(curves: Curves) -> str:
    """Return the commit or the release that made the runs, `several` if they differ, or an empty text without any."""
    commits = {made_by(run.recorded().get("provenance")) for run in curves.runs}
    return commits.pop() if len(commits) == 1 else "several"


def score_text(env: str, value: float, low: float, high: float) -> str:
    """Return a deployed score of the task `env` with its interval, without it if that is nan."""
    return interval_text(value, low, high, ".3f" if make(env).sparse else ".1f")


def _score(curves: Curves, metric: str) -> str:
    if metric not in curves.metrics:
        return "-"
    return score_text(curves.env, *interval_of(curves, seed_scores(curves, metric=metric), metric))
