"""The tables of a page as text, row by row: both of the paper's, how fast, and what each seed ended with."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from earl_jax import assets
from earl_jax.metrics.scores import deployed_area
from earl_jax.metrics.statistics import stderr
from earl_jax.paper.tables import FAULTS, HEADS, WHAT, age_of, table_rows
from earl_jax.paper.verdicts import interval, published
from earl_jax.report.html.runs import Line
from earl_jax.report.style import TITLES, ordered, title
from earl_jax.report.tables import LEVELS, WINDOW, row_of

WIDTH, EDGE, MIDDLE = 240, 5, 13
"""Of a strip of seeds, in pixels: how wide it is, what is left free on either side, and where its dots lie."""
PILE = (0, -5, 5, -9, 9)
"""Where dots go that would lie on each other."""
LAST = {
    "continuing/reward": ("reward a step", 4),
    "interventions": ("interventions", 0),
    "faults": ("faults", 0),
    "reached": ("goals reached", 0),
    "help/asked": ("help asked for", 0),
    "help/enforced": ("help enforced", 0),
    "help/budget": ("budget left", 1),
    "help/over": ("life over", 0),
}
"""What a seed ends with, besides how it does when it is deployed: the name of the column, and digits after the point."""


def said(value: float | None, digits: int) -> str:
    """Return a number for people, a dash where there is none."""
    return "–" if value is None else f"{value:,.{digits}f}".replace("-", "−")


def steps_said(steps: int | None) -> str:
    """Return a number of steps in short: 500, 20k, 2.5M."""
    if steps is None:
        return "–"
    for unit, name in ((1_000_000, "M"), (1_000, "k")):
        if steps >= unit:
            return f"{steps / unit:.3g}{name}"
    return str(steps)


def paper_table(number: int, lines: Sequence[Line]) -> dict[str, Any]:
    """Return table `number` of the paper for the tasks of `lines`: heading, and rows by task, methods not run among them."""
    rows = table_rows(number, [line.cell for line in lines])
    lead, _, text = HEADS[number].partition(": ")
    groups = []
    for env in ordered((line.cell.env for line in lines), TITLES):
        part = [_paper_row(number, row, lines) for row in rows if row["env"] == env]
        groups.append({"title": title(env), "env": env, "rows": part, "fault": FAULTS.get((number, env))})
    return {"lead": lead, "text": text, "what": WHAT[number], "groups": groups}


def _paper_row(number: int, row: dict[str, Any], lines: Sequence[Line]) -> dict[str, Any]:
    found = [line for line in lines if (line.cell.env, line.cell.label) == (row["env"], row["label"])]
    line = next((line for line in found if line.cell.algo == row["algo"]), None)
    theirs = "–" if row["published_mean"] == "-" else row["published_mean"]
    if row["published_stderr"] != "-":
        theirs += f" ({row['published_stderr']})"
    texts = {
        "line": line,
        "label": row["label"],
        "published": theirs.replace("-", "−"),
        "verdict": "" if row["verdict"] == "-" else row["verdict"],
        "age": f"at {age} of steps" if (age := age_of(row)) else "",
    }
    if line is None:
        return texts
    digits = {"deployed/success": 3, "deployed/return": 1}.get(row["metric"], 4)
    texts["lives"] = f"{row['seeds']} × {steps_said(row['steps'])}"
    texts |= {name: said(row[name], digits) for name in ("mean", "stderr", "low", "high")}
    if number == 1:
        inner = row_of(line.cell.curves, 1, "")
        texts |= {name: said(inner[f"deployed_{name}"], digits) for name in ("iqm", "low", "high")}
        texts |= {name: said(row[name], digits) for name in ("last10", "last10_stderr")}
        texts["published_last10"] = row["published_last10"] or "–"
    return texts


def speeds(lines: Sequence[Line]) -> list[dict[str, Any]]:
    """Return, by task, how fast the methods that are judged by success got there, beside the released curves."""
    groups = []
    for env in ordered((line.cell.env for line in lines), TITLES):
        here = [line for line in lines if line.cell.env == env]
        part = [_speed(line) for line in here if line.cell.curves.deployed_metric == "deployed/success"]
        if part:
            groups.append({"title": title(env), "env": env, "rows": part})
    return groups


def _speed(line: Line) -> dict[str, Any]:
    curves, cell = line.cell.curves, line.cell
    ours = row_of(curves, 1, "")
    theirs = assets.published_row("crossings", env=cell.env, algo=cell.algo) if curves.comparable else {}
    area = deployed_area(curves.steps, curves.metrics[curves.deployed_metric])
    steps = ours["steps_per_reward"]
    levels = []
    for level in LEVELS:
        known = theirs.get(f"steps_to_{level}")
        levels.append((steps_said(ours[f"steps_to_{level}"]), steps_said(int(known) if known else None)))
    return {
        "line": line,
        "levels": levels,
        "area": f"{said(area.mean(), 3)} ({said(float(stderr(area)), 3)})",
        "steps_per_reward": said(steps, 1),
        "published_steps_per_reward": theirs.get("steps_per_reward") or "–",
    }


def strips(lines: Sequence[Line]) -> dict[str, Any]:
    """Return where the seeds of one task's `lines` ended, as dots on a common scale from `low` to `high`."""
    finals = [line.cell.curves.metrics[line.cell.curves.deployed_metric][:, -1] for line in lines]
    bounds = [_bounds(line) for line in lines]
    rates = lines[0].cell.curves.deployed_metric == "deployed/success"
    ends = np.concatenate([*finals, *(np.array(pair) for pair in bounds if pair)])
    low, high = (0.0, 1.0) if rates else (float(ends.min()), float(ends.max()))
    digits = 2 if rates else 1

    def place(value: float) -> float:
        share = (value - low) / ((high - low) or 1.0)
        return round(EDGE + (WIDTH - 2 * EDGE) * float(np.clip(share, 0, 1)), 1)

    rows = []
    for line, final, pair in zip(lines, finals, bounds, strict=True):
        inner = row_of(line.cell.curves, 1, "")
        rows.append(
            {
                "line": line,
                "dots": _dots([(place(value), seed, value) for seed, value in zip(line.seeds, final, strict=True)]),
                "mean": place(final.mean()),
                "iqm": [place(inner["deployed_low"]), place(inner["deployed_high"])],
                "published": [place(end) for end in pair] if pair else None,
                "text": f"{said(final.mean(), digits + 1)} ({said(float(stderr(final)), digits + 1)})",
                "values": [said(value, digits) for value in sorted(final.tolist())],
            }
        )
    return {"rows": rows, "low": said(low, digits), "high": said(high, digits)}


def _bounds(line: Line) -> tuple[float, float] | None:
    printed = published("table1", line.cell.env, line.cell.algo) if line.cell.curves.comparable else None
    return interval(*printed) if printed else None


def _dots(places: Sequence[tuple[float, int, float]]) -> list[dict[str, Any]]:
    """Return dots for (x, seed, value), those that would lie on each other piled up."""
    piles: dict[int, int] = {}
    dots = []
    for x, seed, value in sorted(places):
        height = piles[round(x / 5)] = piles.get(round(x / 5), -1) + 1
        dots.append({"x": x, "y": MIDDLE + PILE[height % len(PILE)], "text": f"seed {seed}: {said(value, 3)}"})
    return dots


def seed_table(lines: Sequence[Line]) -> dict[str, Any]:
    """Return what every seed of one task's `lines` ended with: names of columns, and a row of texts a seed."""
    kept = [name for name in LAST if any(name in line.cell.curves.metrics for line in lines)]
    rates = lines[0].cell.curves.deployed_metric == "deployed/success"
    digits = 3 if rates else 1
    head = ["success" if rates else "return", f"mean of the last {WINDOW}", *(LAST[name][0] for name in kept)]
    rows = []
    for line in lines:
        metrics = line.cell.curves.metrics
        scores = metrics[line.cell.curves.deployed_metric]
        for place, seed in enumerate(line.seeds):
            texts = [said(scores[place, -1], digits), said(scores[place, -WINDOW:].mean(), digits)]
            for name in kept:
                texts.append(said(metrics[name][place, -1] if name in metrics else None, LAST[name][1]))
            rows.append({"line": line, "seed": seed, "texts": texts})
    return {"head": head, "rows": rows}
