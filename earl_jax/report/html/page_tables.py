"""The tables of a page as text: tables 1 and 2 of the paper, speed of learning, and final scores of seeds."""

import math
from collections.abc import Sequence
from typing import Any

from earl_jax.metrics.continuing import diverged_text
from earl_jax.report.html.curves import PANELS
from earl_jax.report.html.lines import Line
from earl_jax.report.paper_rows import DESCRIPTIONS, HEADINGS, paper_rows, share_of_steps
from earl_jax.report.published import (
    PublishedScore,
    published_fault,
)
from earl_jax.report.scores import WINDOW, last_mean
from earl_jax.report.style import task_order, task_title
from earl_jax.report.tables import steps_text


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


def seed_table(lines: Sequence[Line]) -> dict[str, Any]:
    """Return the final values of every seed of one task's `lines`: names of columns, and a row of texts per seed.

    The first two columns are the last deployed score and the mean of the last ten; the others are those of `PANELS`.
    """
    panels = [panel for panel in PANELS if panel.metric and any(panel.metric in line.curves.metrics for line in lines)]
    rows = []
    for line in lines:
        metrics = line.curves.metrics
        scores = metrics[line.curves.deployed_metric]
        for lane, seed in enumerate(line.seeds):
            values = [scores[lane, -1], last_mean(scores[lane])]
            values += [metrics[panel.metric][lane, -1] if panel.metric in metrics else math.nan for panel in panels]
            texts = [number_text(value, 0) if not abs(value) < 1000 else f"{value:.4g}" for value in values]
            rows.append({"line": line, "seed": seed, "texts": texts})
    name = lines[0].curves.deployed_metric.removeprefix("deployed/")
    return {"head": [name, f"mean of the last {WINDOW}", *(panel.title for panel in panels)], "rows": rows}


def number_text(value: float | None, digits: int) -> str:
    """Return a number with `digits` after the point, `–` for None and nan."""
    return "–" if value is None or math.isnan(value) else f"{value:,.{digits}f}".replace("-", "−")
