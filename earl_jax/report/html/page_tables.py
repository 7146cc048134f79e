"""The tables of a page as text: tables 1 and 2 of the paper, speed of learning, and final scores of seeds."""

import math
from collections.abc import Sequence
from typing import Any

from earl_jax.metrics.continuing import DIVERGED, diverged_text
from earl_jax.metrics.deployed import WIDE
from earl_jax.metrics.life import ALIVE, BACK, FORWARD, STILL
from earl_jax.metrics.scores import deployed_area
from earl_jax.metrics.statistics import stderr
from earl_jax.report.html.lines import Line
from earl_jax.report.paper_rows import DESCRIPTIONS, HEADINGS, paper_rows, share_of_steps
from earl_jax.report.published import (
    LEVELS,
    PublishedScore,
    crossings_beside,
    published_fault,
    row_beside,
)
from earl_jax.report.scores import WINDOW, last_mean, level_crossings, steps_per_reward
from earl_jax.report.style import task_order, task_title
from earl_jax.report.tables import steps_text

FINAL_COLUMNS = {
    WIDE: ("success from wide starts", 3),
    "continuing/reward": ("reward per step", 4),
    "interventions": ("interventions", 0),
    "faults": ("faults", 0),
    DIVERGED: ("diverged", 0),
    "reached": ("goals reached", 0),
    FORWARD: ("forward phases reached", 2),
    BACK: ("ways back reached", 2),
    ALIVE: ("alive", 0),
    STILL: ("steps since the object moved", 0),
    "help/asked": ("requested help", 0),
    "help/enforced": ("enforced help", 0),
    "help/budget": ("remaining budget", 1),
    "help/over": ("lifetime over", 0),
}
"""Columns of final values of a seed besides its deployed score: the heading, and digits after the point."""


def paper_table(number: int, lines: Sequence[Line]) -> dict[str, Any]:
    """Return table `number` of the paper for the tasks of `lines`: heading, and rows by task with methods not run."""
    rows = paper_rows(number, [line.group for line in lines])
    lead, _, text = HEADINGS[number].partition(": ")
    groups = []
    for env in task_order(line.group.env for line in lines):
        task_rows = [_paper_row(number, row, lines) for row in rows if row["env"] == env]
        fault = published_fault(f"table{number}", env)
        groups.append({"title": task_title(env), "env": env, "rows": task_rows, "fault": fault})
    return {"lead": lead, "text": text, "description": DESCRIPTIONS[number], "groups": groups}


def _paper_row(number: int, row: dict[str, Any], lines: Sequence[Line]) -> dict[str, Any]:
    name = (row["env"], row["algo"], row["label"])
    line = next((line for line in lines if (line.group.env, line.group.algo, line.group.label) == name), None)
    published = PublishedScore(row["published_mean"], row["published_stderr"])
    share = share_of_steps(row)
    texts = {
        "line": line,
        "label": row["label"],
        "published": "–" if published.mean == "-" else published.text.replace("-", "−"),
        "verdict": "" if row["verdict"] == "-" else row["verdict"],
        "share": f"at {share} of steps" if share else "",
        "p": f"p = {row['p_holm']:.2g}" if row["p_holm"] is not None else "",
    }
    if line is None:
        return texts
    digits = {"deployed/success": 3, "deployed/return": 1}.get(row["metric"], 4)
    texts["size"] = f"{row['seeds']} × {steps_text(row['steps'])}{diverged_text(row['diverged'], row['seeds'])}"
    texts |= {name: number_text(row[name], digits) for name in ("mean", "stderr", "low", "high")}
    if number == 1:
        texts |= {name: number_text(row[name], digits) for name in ("recent", "recent_stderr")}
        texts["published_last10"] = row["published_last10"] or "–"
    return texts


def speeds(lines: Sequence[Line]) -> list[dict[str, Any]]:
    """Return, by task, how fast the methods scored by success learned, beside the released curves."""
    groups = []
    for env in task_order(line.group.env for line in lines):
        of_task = [line for line in lines if line.group.env == env]
        rows = [_speed(line) for line in of_task if line.curves.deployed_metric == "deployed/success"]
        if rows:
            groups.append({"title": task_title(env), "env": env, "rows": rows})
    return groups


def _speed(line: Line) -> dict[str, Any]:
    curves = line.curves
    ours, published = level_crossings(curves), crossings_beside(curves)
    mean_heights = deployed_area(curves.steps, curves.metrics[curves.deployed_metric])
    return {
        "line": line,
        "levels": [(steps_text(ours[level].value), steps_text(published.get(level))) for level in LEVELS],
        "deployed_area": f"{number_text(mean_heights.mean(), 3)} ({number_text(float(stderr(mean_heights)), 3)})",
        "steps_per_reward": number_text(steps_per_reward(curves), 1),
        "published_steps_per_reward": row_beside("crossings", curves).get("steps_per_reward") or "–",
    }


def seed_table(lines: Sequence[Line]) -> dict[str, Any]:
    """Return the final values of every seed of one task's `lines`: names of columns, and a row of texts per seed."""
    names = [name for name in FINAL_COLUMNS if any(name in line.curves.metrics for line in lines)]
    rates = lines[0].curves.deployed_metric == "deployed/success"
    digits = 3 if rates else 1
    columns = ["success" if rates else "return", f"mean of the last {WINDOW}"]
    rows = []
    for line in lines:
        metrics = line.curves.metrics
        scores = metrics[line.curves.deployed_metric]
        for lane, seed in enumerate(line.seeds):
            texts = [number_text(scores[lane, -1], digits), number_text(float(last_mean(scores[lane])), digits)]
            for name in names:
                value = metrics[name][lane, -1] if name in metrics else None
                texts.append(number_text(value, FINAL_COLUMNS[name][1]))
            rows.append({"line": line, "seed": seed, "texts": texts})
    return {"head": [*columns, *(FINAL_COLUMNS[name][0] for name in names)], "rows": rows}


def number_text(value: float | None, digits: int) -> str:
    """Return a number with `digits` after the point, `–` for None and nan."""
    return "–" if value is None or math.isnan(value) else f"{value:,.{digits}f}".replace("-", "−")
