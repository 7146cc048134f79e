"""Our scores beside those published in tables 1 and 2 of the paper, one row per task and method.

Source: Sharma et al. 2022, tables 1 and 2.
"""

from collections.abc import Sequence
from typing import Any

from earl_jax import assets
from earl_jax.metrics.statistics import mean_of, stderr
from earl_jax.report.published import published_score, published_steps, verdict
from earl_jax.report.runs import MethodRuns, options_text
from earl_jax.report.style import method_order, task_order
from earl_jax.report.tables import WINDOW

HEADINGS = {
    1: "Table 1: deployed performance of the final policy",
    2: "Table 2: average reward over the lifetime",
}
DESCRIPTIONS = {
    1: "Success rate for sparse rewards, return for dense ones; the last evaluation only, as published.",
    2: "Task reward per step, averaged over all steps of the lifetime (`continuing/reward` at the end).",
}


def paper_rows(number: int, groups: Sequence[MethodRuns]) -> list[dict[str, Any]]:
    """Return the rows of table `number` in the paper's order: those of `groups`, and published ones not run."""
    names = [(row["env"], row["algo"]) for row in assets.published(f"table{number}")]
    names += [(group.env, group.algo) for group in groups]
    rows = []
    for env in task_order(env for env, _ in names):
        for algo in method_order(algo for name, algo in names if name == env):
            runs = [group for group in groups if (group.env, group.algo) == (env, algo)]
            rows += [_row(number, env, algo, group) for group in runs or [None]]
    return rows


def _row(number: int, env: str, algo: str, group: MethodRuns | None) -> dict[str, Any]:
    comparable = group is None or group.curves.comparable
    score = published_score(f"table{number}", env, algo) if comparable else None
    low, high = (score and score.interval) or (None, None)
    steps_low, steps_high = published_steps(env) or (None, None)
    ours = _measured(number, group)
    row = {
        "env": env,
        "algo": algo,
        "label": group.label if group else algo,
        "options": options_text(group.curves.options) if group else None,
        **ours,
        "published_mean": score.mean if score else "-",
        "published_stderr": score.stderr if score else "-",
        "published_low": low,
        "published_high": high,
        "published_steps_low": steps_low,
        "published_steps_high": steps_high,
        "verdict": verdict(ours["mean"], score.interval if score else None),
    }
    if number == 1:
        crossings = assets.published_row("crossings", env=env, algo=algo) if comparable else {}
        row["published_last10"] = crossings.get("last10") or None
    return row


def _measured(number: int, group: MethodRuns | None) -> dict[str, Any]:
    """Return the scores of the seeds of `group`, all of them None without a run."""
    names = ["metric", "seeds", "diverged", "steps", "mean", "stderr", "low", "high"]
    names += ["last10", "last10_stderr"] if number == 1 else []
    if group is None:
        return dict.fromkeys(names)
    metric = group.curves.deployed_metric if number == 1 else "continuing/reward"
    scores = group.curves.metrics[metric]
    estimate = mean_of(scores[:, -1])
    row = {
        "metric": metric,
        "seeds": len(scores),
        "diverged": group.curves.diverged,
        "steps": int(group.curves.steps[-1]),
        "mean": estimate.value,
        "stderr": float(stderr(scores[:, -1])),
        "low": estimate.low,
        "high": estimate.high,
    }
    if number == 1:
        recent = scores[:, -WINDOW:].mean(axis=1)
        row |= {"last10": float(recent.mean()), "last10_stderr": float(stderr(recent))}
    return row


def share_of_steps(row: dict[str, Any]) -> str:
    """Return the share of the published steps after which a verdict was reached; empty if it was after all of them."""
    least = row["published_steps_low"]
    if row["verdict"] == "-" or not least or row["steps"] >= least:
        return ""
    return f"{100 * row['steps'] / least:.2g} %"
