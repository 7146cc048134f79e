"""All that a page says of its lines, as texts and numbers that its template and its script lay out."""

import datetime
from collections.abc import Sequence
from typing import Any

from earl_jax.paper.verdicts import FEW, FEW_SEEDS, RULE
from earl_jax.report.html.curves import POINTS, panels
from earl_jax.report.html.media import Album, maps
from earl_jax.report.html.origin import changed, dated, day, origins, run_card, values_of
from earl_jax.report.html.runs import Line, Run
from earl_jax.report.html.tables import WIDTH, paper_table, seed_table, speeds, steps_said, strips
from earl_jax.report.style import TITLES, ordered, title
from earl_jax.report.tables import WINDOW

CROWD = 6
"""Lines of a task above which bands are hidden at first, and notes count lines instead of naming them."""


def content(lines: Sequence[Line]) -> dict[str, Any]:
    """Return what the template says of `lines`."""
    album, runs = Album(), [run for line in lines for run in line.runs]
    envs = ordered((line.cell.env for line in lines), TITLES)
    parts = _by_task(lines)
    tasks = [_task(f"t{place}", name, part, album) for place, (name, part) in enumerate(parts.items())]
    return {
        "heading": ", ".join(map(title, envs[:3])) + (f" and {len(envs) - 3} more" if len(envs) > 3 else ""),
        "tasks": tasks,
        "lines": lines,
        "facts": _facts(lines, runs),
        "papers": [paper_table(number, lines) for number in (1, 2)],
        "speeds": speeds(lines),
        "rule": RULE + (f" {FEW_SEEDS}" if any(len(line.seeds) < FEW for line in lines) else ""),
        "cards": [run_card(line, run) for line in lines for run in line.runs],
        "origins": origins(runs),
        "window": WINDOW,
        "strip_width": WIDTH,
    }


def numbers(told: dict[str, Any]) -> dict[str, Any]:
    """Return the part of `content` that plots are drawn from, as plain JSON."""
    return {
        task["id"]: {
            "looks": {line.key: {"label": line.cell.label, "dash": line.dash} for line in task["lines"]},
            "panels": task["panels"],
            "maps": [{**one, "line": one["line"].key} for one in task["maps"]],
        }
        for task in told["tasks"]
    }


def _facts(lines: Sequence[Line], runs: Sequence[Run]) -> list[tuple[str, str]]:
    seeds = sum(len(line.seeds) for line in lines)
    lived = sum(int(line.cell.curves.steps[-1]) * len(line.seeds) for line in lines)
    versions = {"earl-jax": "earl-jax", "jax": "jax", "Python": "python"}
    return [
        ("Runs", f"{len(runs)}, with {seeds} lives of {steps_said(lived)} steps in all"),
        ("Methods", ", ".join(dict.fromkeys(line.cell.algo for line in lines))),
        ("When", f"{dated(runs)}; this page, {day(datetime.datetime.now(datetime.UTC))}"),
        ("Hardware", values_of(runs, "device")),
        ("Versions", "; ".join(f"{name} {values_of(runs, key)}" for name, key in versions.items())),
        ("Commit", values_of(runs, "commit", 12)),
    ]


def _by_task(lines: Sequence[Line]) -> dict[str, list[Line]]:
    """Return the lines of each task by its title, those judged by success apart from those judged by return."""
    groups: dict[tuple[str, str], list[Line]] = {}
    for line in lines:
        groups.setdefault((line.cell.env, line.cell.curves.deployed_metric), []).append(line)
    envs = [env for env, _ in groups]
    return {
        title(env) + (f", judged by {metric.removeprefix('deployed/')}" if envs.count(env) > 1 else ""): part
        for (env, metric), part in groups.items()
    }


def _task(key: str, name: str, lines: Sequence[Line], album: Album) -> dict[str, Any]:
    """Return all that the page says of one task."""
    drawn, (places, without) = panels(lines), maps(lines)
    pairs = [album.videos(line) for line in lines]
    curves = [one for panel in drawn for one in panel["lines"]]
    longest = max(len(line.cell.curves.steps) for line in lines)
    return {
        "id": key,
        "env": lines[0].cell.env,
        "title": name,
        "lines": lines,
        "options": [(line, changed(line)) for line in lines],
        "notes": _notes(lines),
        "panels": drawn,
        "smooth": any(one["smooth"] for one in curves),
        "banded": any(one["plain"]["low"] for one in curves),
        "published": any(one["published"] for one in curves),
        "crossed": any(one["published"]["crossings"] for one in curves if one["published"]),
        "crowded": len(lines) > CROWD,
        "thinned": (POINTS, longest) if longest > POINTS else None,
        "strips": strips(lines),
        "seeds": seed_table(lines),
        "maps": places,
        "without": without,
        "videos": [video for found, _ in pairs for video in found],
        "unseen": [sentence for _, sentences in pairs for sentence in sentences],
    }


def _notes(lines: Sequence[Line]) -> list[str]:
    """Return what a reader of one task's numbers should know about its runs."""
    notes: list[str] = []
    unfinished: dict[str, list[str]] = {}
    for line in lines:
        lived, planned = int(line.cell.curves.steps[-1]), max(run.config.steps for run in line.runs)
        if lived < planned:
            unfinished.setdefault(f"{lived:,} of {planned:,} steps lived", []).append(line.cell.label)
    for told, names in unfinished.items():
        listed = ", ".join(names) if len(names) < CROWD else f"{len(names)} lines"
        notes.append(f"{'Each line' if len(names) == len(lines) > 1 else listed}: {told}.")
    for line in lines:
        twice = ", ".join(str(seed) for seed in sorted(set(line.seeds)) if line.seeds.count(seed) > 1)
        if twice:
            notes.append(f"{line.cell.label}: of seed {twice} there is more than one life here, and every one counts.")
    return notes
