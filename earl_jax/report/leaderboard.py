"""The rows of the leaderboard: those that ship (assets/published/leaderboard.csv), and the row of any run beside them.

The file has the published scores and the runs of this repository; `python -m benchmarks.paper.leaderboard` writes it and
docs/leaderboard.md from the same rows.
"""

import math
from collections.abc import Iterable
from typing import Any, NamedTuple

from earl_jax import assets
from earl_jax.envs import make
from earl_jax.metrics.deployed import WIDE
from earl_jax.metrics.phase_stats import ALIVE
from earl_jax.metrics.scores import DEFAULT
from earl_jax.report.paper_rows import CONTINUING
from earl_jax.report.published import chosen_words
from earl_jax.report.runs import Curves
from earl_jax.report.scores import LEVELS, interval_of, level_crossings, seed_scores
from earl_jax.report.style import grouped
from earl_jax.report.tables import interval_text, millions, step_interval
from earl_jax.runs.provenance import made_by, short_commit

TABLE = "leaderboard"
OURS = "earl_jax"
HEADER = (
    "method", "from", "seeds", "steps", "deployed [95 %]", "wide [95 %]", "C(A) [95 %]", "alive",
    *(f"to {level}" for level in LEVELS), "chosen", "commit",
)  # fmt: skip


class Row(NamedTuple):
    """A row of the leaderboard as texts; the rows of a task are sorted by `score`, the mean deployed score, highest first.

    A text of what a row does not have is `-`.
    """

    env: str
    method: str
    source: str
    seeds: int
    steps: int
    deployed: str
    wide: str = "-"
    continuing: str = "-"
    alive: str = "-"
    crossings: tuple[str, ...] = ("-",) * len(LEVELS)
    chosen: str = "-"
    commit: str = "-"
    score: float = math.nan

    @property
    def texts(self) -> list[str]:
        """The cells of the table, in the order of `HEADER`."""
        texts = [self.method, self.source, str(self.seeds), millions(self.steps), self.deployed, self.wide]
        return [*texts, self.continuing, self.alive, *self.crossings, self.chosen, self.commit]


CROSSINGS = tuple(f"to_{level}" for level in LEVELS)
"""The columns of the file that have the crossings."""


def values_of(row: Row) -> dict[str, Any]:
    """Return a row by the columns of the file; scores are rounded to six digits after the point."""
    values: dict[str, Any] = {}
    for name, value in row._asdict().items():
        values |= dict(zip(CROSSINGS, value, strict=True)) if name == "crossings" else {name: value}
    return values | {"score": round(row.score, 6)}


def shipped_rows() -> list[Row]:
    """Return the rows that ship, of all tasks."""
    kinds = {"seeds": int, "steps": int, "score": float}
    rows = []
    for values in assets.published(TABLE):
        fields = {name: kinds.get(name, str)(values[name]) for name in Row._fields if name != "crossings"}
        rows.append(Row(**fields, crossings=tuple(values[name] for name in CROSSINGS)))
    return rows


def ranked(rows: Iterable[Row]) -> dict[str, list[Row]]:
    """Return `rows` by task, in the order in which tasks occur, those of a task by their score."""
    by_task = grouped(rows, lambda row: row.env)
    return {env: sorted(members, key=lambda row: -row.score) for env, members in by_task.items()}


def run_row(curves: Curves, source: str = OURS) -> Row:
    """Return the row of a run: scores by the default `Window`, each with its 95 % interval over seeds."""
    curves = curves._replace(window=DEFAULT)
    deployed, wide = (_score(curves, metric) for metric in (curves.deployed_metric, WIDE))
    alive = curves.metrics[ALIVE][:, -1].mean() if ALIVE in curves.metrics else None
    return Row(
        env=curves.env,
        method=curves.label,
        source=source,
        seeds=curves.seeds,
        steps=int(curves.steps[-1]),
        deployed=deployed,
        wide=wide,
        continuing=interval_text(*interval_of(curves, curves.metrics[CONTINUING][:, -1], CONTINUING)),
        alive="-" if alive is None else f"{alive:.0%}",
        crossings=tuple(map(step_interval, level_crossings(curves).values())),
        chosen=chosen_words(curves),
        commit=short_commit(commit_of(curves)) or "-",
        score=float(seed_scores(curves).mean()),
    )


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
