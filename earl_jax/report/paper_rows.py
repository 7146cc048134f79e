"""Our scores beside those published in tables 1 and 2 of the paper, one row per task and method.

Source: Sharma et al. 2022, tables 1 and 2.
"""

from collections.abc import Sequence

import numpy as np

from earl_jax import assets
from earl_jax.metrics.scores import CONTINUING, DEFAULT
from earl_jax.metrics.statistics import stderr
from earl_jax.report.comparison import comparison_columns, with_verdicts
from earl_jax.report.published import (
    PublishedScore,
    chosen_words,
    published_beside,
    published_score,
    published_steps,
    released_beside,
    share_text,
    training_steps,
)
from earl_jax.report.runs import Curves, common_step, options_text
from earl_jax.report.scores import interval_of, over_same_steps, seed_scores
from earl_jax.report.style import method_order, task_order
from earl_jax.report.tables import Row

HEADINGS = {
    1: "Table 1: deployed performance of the final policy",
    2: "Table 2: average reward over the lifetime",
}
DESCRIPTIONS = {
    1: f"Success rate for sparse rewards, return for dense ones: the mean over {DEFAULT.text}. The printed numbers are of the "
    "last evaluation.",
    2: "Task reward per step, averaged over all steps of the lifetime (`continuing/reward` at the end).",
}
MEASURED = ("options", "chosen", "metric", "seeds", "diverged", "steps", "mean", "stderr", "low", "high")
"""The columns of our run, which are None without one."""
TESTED = (
    "tested_steps", "tested_mean", "other_mean", "other_seeds", "difference", "difference_low", "difference_high", "detectable",
    "p", "p_holm",
)  # fmt: skip
"""The columns of the test, which are None without one."""


def paper_rows(number: int, runs: Sequence[Curves]) -> list[Row]:
    """Return the rows of table `number` in the paper's order: those of `runs`, and published ones not run."""
    names = [(row["env"], row["algo"]) for row in assets.published(f"table{number}")]
    names += [(curves.env, curves.algo) for curves in runs]
    rows = []
    for env in task_order(env for env, _ in names):
        for algo in method_order(algo for name, algo in names if name == env):
            own = [curves for curves in runs if (curves.env, curves.algo) == (env, algo)]
            rows += [_row(number, env, algo, curves) for curves in own or [None]]
    with_verdicts([row for row in rows if row["p"] is not None])
    return rows


def _row(number: int, env: str, algo: str, curves: Curves | None) -> Row:
    score = published_beside(number, curves) if curves else published_score(number, env, algo)
    low, high = score.interval if score else (None, None)
    steps_low, steps_high = published_steps(env) or (None, None)
    row = {
        "env": env,
        "algo": algo,
        "label": algo,
        **dict.fromkeys(MEASURED),
        "published_mean": score.mean if score else "-",
        "published_stderr": score.stderr if score else "-",
        "published_low": low,
        "published_high": high,
        "published_steps_low": steps_low,
        "published_steps_high": steps_high,
        **dict.fromkeys(TESTED),
        "verdict": "-",
    }
    if curves:
        metric, scores = curves.deployed_metric if number == 1 else CONTINUING, table_scores(number, curves)
        row |= {
            "label": curves.label, "options": options_text(curves.options), "chosen": chosen_words(curves), "metric": metric,
            "seeds": len(scores), "diverged": curves.diverged, "steps": curves.length, "stderr": float(stderr(scores)),
            **interval_of(curves, scores, metric).columns("mean"), **columns_of_test(number, curves, score),
        }  # fmt: skip
    return row


def columns_of_test(number: int, curves: Curves, score: PublishedScore | None = None) -> Row:
    """Return the columns of the test against the released runs, or else against the printed `score` at its length; {} without."""
    released = released_beside(curves)
    if released is None:
        step, other = curves.length, score and score.sample
        if not other or step < training_steps(curves.env):
            return {}
    else:
        step = common_step(curves, released)
        if step is None or (number == 2 and CONTINUING not in released.metrics):
            return {}
        curves, released = over_same_steps((curves, released), step)
        other = table_scores(number, released)
    own = table_scores(number, curves)
    return {"tested_steps": step, "tested_mean": float(own.mean()), **comparison_columns(own, other, "difference_")}


def table_scores(number: int, curves: Curves) -> np.ndarray:
    """Return the scores [N] of seeds: deployed ones for table 1, rewards over the life for table 2."""
    return seed_scores(curves) if number == 1 else curves.metrics[CONTINUING][:, -1]


def share_of_steps(row: Row) -> str:
    """Return, as `at 12 % of the steps`, the share of the published ones that a shorter run has; else an empty text."""
    least = row["published_steps_low"]
    if row["published_mean"] == "-" or row["steps"] is None or row["steps"] >= least:
        return ""
    return f"at {share_text(row['steps'], least)} of the steps"
