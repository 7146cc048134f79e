"""The tables of a page as text: tables 1 and 2 of the paper, speed of learning, and final scores of seeds."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from earl_jax.metrics.continuing import DIVERGED, diverged_text
from earl_jax.metrics.deployed import WIDE
from earl_jax.metrics.life import ALIVE, BACK, FORWARD, STILL
from earl_jax.metrics.scores import deployed_area
from earl_jax.metrics.statistics import stderr
from earl_jax.report.html.runs import Line
from earl_jax.report.html.text import number_text, steps_text
from earl_jax.report.paper_rows import DESCRIPTIONS, HEADINGS, paper_rows, share_of_steps
from earl_jax.report.published import (
    LEVELS,
    PublishedScore,
    crossings_beside,
    curve_beside,
    published_beside,
    published_fault,
)
from earl_jax.report.style import task_order, task_title
from earl_jax.report.tables import WINDOW, row_of

STRIP_WIDTH, STRIP_MARGIN, STRIP_MIDDLE = 240, 5, 13
"""Of a strip of seeds, in pixels: its width, the margin on either side, and the height of its dots."""
OFFSETS = (0, -5, 5, -9, 9)
"""Vertical offsets of dots that would cover each other."""
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
    ours = row_of(curves, 1, "")
    crossings = crossings_beside(curves)
    mean_heights = deployed_area(curves.steps, curves.metrics[curves.deployed_metric])
    return {
        "line": line,
        "levels": [(steps_text(ours[f"steps_to_{level}"]), steps_text(crossings.get(level))) for level in LEVELS],
        "deployed_area": f"{number_text(mean_heights.mean(), 3)} ({number_text(float(stderr(mean_heights)), 3)})",
        "steps_per_reward": number_text(ours["steps_per_reward"], 1),
        "published_steps_per_reward": curve_beside(curves).get("steps_per_reward") or "–",
    }


class Scale(NamedTuple):
    """The scale of a strip of seeds from `low` to `high`."""

    low: float
    high: float

    def x(self, value: float) -> float:
        """Return the horizontal position of `value` in pixels, clipped to the strip."""
        share = (value - self.low) / ((self.high - self.low) or 1.0)
        return round(STRIP_MARGIN + (STRIP_WIDTH - 2 * STRIP_MARGIN) * float(np.clip(share, 0, 1)), 1)


def strips(lines: Sequence[Line]) -> dict[str, Any]:
    """Return the final scores of the seeds of one task's `lines`, as dots on a common scale from `low` to `high`."""
    rates = _rates(lines)
    finals = [line.curves.metrics[line.curves.deployed_metric][:, -1] for line in lines]
    intervals = [_published_interval(line) for line in lines]
    ends = np.concatenate([*finals, *(np.array(interval) for interval in intervals if interval)])
    scale = Scale(0.0, 1.0) if rates else Scale(float(ends.min()), float(ends.max()))
    digits = 2 if rates else 1
    rows = [
        _strip(line, final, interval, scale, digits)
        for line, final, interval in zip(lines, finals, intervals, strict=True)
    ]
    return {"rows": rows, "low": number_text(scale.low, digits), "high": number_text(scale.high, digits)}


def _strip(
    line: Line, final: np.ndarray, published: tuple[float, float] | None, scale: Scale, digits: int
) -> dict[str, Any]:
    row = row_of(line.curves, 1, "")
    return {
        "line": line,
        "dots": _dots([(scale.x(value), seed, value) for seed, value in zip(line.seeds, final, strict=True)]),
        "mean": scale.x(final.mean()),
        "interval": None
        if math.isnan(row["deployed_low"])
        else [scale.x(row["deployed_low"]), scale.x(row["deployed_high"])],
        "published": [scale.x(end) for end in published] if published else None,
        "text": f"{number_text(final.mean(), digits + 1)} ({number_text(float(stderr(final)), digits + 1)})",
        "values": [number_text(value, digits) for value in sorted(final.tolist())],
    }


def _rates(lines: Sequence[Line]) -> bool:
    return lines[0].curves.deployed_metric == "deployed/success"


def _published_interval(line: Line) -> tuple[float, float] | None:
    score = published_beside("table1", line.curves)
    return score.interval if score else None


def _dots(points: Sequence[tuple[float, int, float]]) -> list[dict[str, Any]]:
    """Return dots for (x, seed, value), moved up and down so that they do not cover each other."""
    counts: dict[int, int] = {}
    dots = []
    for x, seed, value in sorted(points):
        column = round(x / 5)
        offset = OFFSETS[counts.get(column, 0) % len(OFFSETS)]
        counts[column] = counts.get(column, 0) + 1
        dots.append({"x": x, "y": STRIP_MIDDLE + offset, "text": f"seed {seed}: {number_text(value, 3)}"})
    return dots


def seed_table(lines: Sequence[Line]) -> dict[str, Any]:
    """Return the final values of every seed of one task's `lines`: names of columns, and a row of texts per seed."""
    names = [name for name in FINAL_COLUMNS if any(name in line.curves.metrics for line in lines)]
    rates = _rates(lines)
    digits = 3 if rates else 1
    columns = ["success" if rates else "return", f"mean of the last {WINDOW}"]
    rows = []
    for line in lines:
        metrics = line.curves.metrics
        scores = metrics[line.curves.deployed_metric]
        for lane, seed in enumerate(line.seeds):
            texts = [number_text(scores[lane, -1], digits), number_text(scores[lane, -WINDOW:].mean(), digits)]
            for name in names:
                value = metrics[name][lane, -1] if name in metrics else None
                texts.append(number_text(value, FINAL_COLUMNS[name][1]))
            rows.append({"line": line, "seed": seed, "texts": texts})
    return {"head": [*columns, *(FINAL_COLUMNS[name][0] for name in names)], "rows": rows}
