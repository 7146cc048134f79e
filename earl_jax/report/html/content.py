"""The content of a page, as texts and numbers that the page's template and script lay out."""

import datetime
import json
import shlex
from collections.abc import Sequence
from typing import Any

from earl_jax.options.values import counted
from earl_jax.report.comparison import RULE
from earl_jax.report.html.curves import POINTS, Line, panels
from earl_jax.report.html.media import PolicyVideos, Video, maps, videos
from earl_jax.report.html.page_tables import UNKNOWN, difference_table, leaderboard, paper_table, provenance, seed_table
from earl_jax.report.published import INTERVAL_RULE
from earl_jax.report.runs import options_text
from earl_jax.report.scores import SMOOTH
from earl_jax.report.style import grouped, task_order, task_title
from earl_jax.report.tables import steps_text, windows_text
from earl_jax.runs.folder import RunFolder
from earl_jax.runs.provenance import short_commit

CROWD = 6
"""Above this number of lines, a task's bands are hidden at first, and its lines are not compared with each other."""


def page_content(lines: Sequence[Line], policies: PolicyVideos | None = None) -> dict[str, Any]:
    """Return the variables of the template for `lines`, with videos of their `policies`."""
    titles = [task_title(env) for env in task_order(line.curves.env for line in lines)]
    origins = [provenance(run) for line in lines for run in line.curves.runs]
    names = dict.fromkeys(name for origin in origins for name in origin)
    versions = {name: list(dict.fromkeys(origin.get(name, UNKNOWN) for origin in origins)) for name in names}
    shown = videos(lines, policies)
    tasks = grouped(lines, lambda line: (line.curves.env, line.curves.deployed_metric))
    return {
        "heading": ", ".join(titles[:3]) + (f" and {len(titles) - 3} more" if len(titles) > 3 else ""),
        "tasks": [_task_section(f"t{number}", members, shown) for number, members in enumerate(tasks.values())],
        "lines": lines,
        "summary": _summary(lines, versions),
        "rule": INTERVAL_RULE,
        "difference_rule": RULE.format(window=windows_text(line.curves.window.text for line in lines)),
        "cards": [_run_card(line, run) for line in lines for run in line.curves.runs],
        "versions": {name: ", ".join(values) for name, values in versions.items()},
        "differing": [name for name, values in versions.items() if len(values) > 1],
        "window": SMOOTH,
        "points": POINTS,
    }


def _summary(lines: Sequence[Line], versions: dict[str, list[str]]) -> dict[str, str]:
    runs = len({run.path for line in lines for run in line.curves.runs})
    seeds = sum(len(line.seeds) for line in lines)
    steps = sum(line.curves.length * len(line.curves.run_seeds) for line in lines)
    return {
        "Runs": f"{runs}, with {counted(seeds, 'seed')} and {steps_text(steps)} steps in total",
        "Methods": ", ".join(dict.fromkeys(line.curves.algo for line in lines)),
        "Written": f"{datetime.datetime.now(datetime.UTC):%Y-%m-%d}",
        "Hardware": ", ".join(versions["device"]),
        "Commit": ", ".join(map(short_commit, versions["commit"])),
    }


def _task_section(key: str, lines: Sequence[Line], shown: Sequence[Video]) -> dict[str, Any]:
    """Return everything that the page shows of one task, whose `lines` have the same deployed metric."""
    keys = {line.key for line in lines}
    plots, (visit_maps, sentences) = panels(lines), maps(lines)
    of_task = [video for video in shown if video.line.key in keys]
    return {
        "id": key,
        "env": lines[0].curves.env,
        "title": task_title(lines[0].curves.env),
        "metric": lines[0].curves.deployed_metric,
        "lines": lines,
        "notes": _notes(lines),
        "panels": plots,
        "banded": any(curve["plain"]["low"] for plot in plots for curve in plot["lines"]),
        "crowded": len(lines) > CROWD,
        "tables": [paper_table(number, lines) for number in (1, 2)],
        "differences": difference_table(lines) if 1 < len(lines) <= CROWD else None,
        "leaderboard": leaderboard(lines),
        "seeds": seed_table(lines),
        "maps": visit_maps,
        "videos": [video for video in of_task if not video.problem],
        "absent": sentences + [video.problem for video in of_task if video.problem],
    }


def _notes(lines: Sequence[Line]) -> list[str]:
    """Return notes on one task's runs: unfinished ones, and seeds that ran twice."""
    notes: list[str] = []
    for line in lines:
        trained, planned = line.curves.length, max(run.config.steps for run in line.curves.runs)
        if trained < planned:
            notes.append(f"{line.curves.label}: {trained:,} of {planned:,} steps trained.")
        if repeated := ", ".join(map(str, sorted(line.curves.repeated_seeds))):
            notes.append(f"{line.curves.label}: seed {repeated} ran more than once and counts by the mean of its runs.")
    return notes


def _run_card(line: Line, run: RunFolder) -> dict[str, Any]:
    """Return the card of one run: its length, its options, the command that repeats it, its whole config."""
    whole = run.recorded()
    return {
        "line": line,
        "path": str(run.path),
        "seeds": len(run.config.seeds),
        "steps": steps_text(run.config.steps),
        "options": options_text(line.curves.options),
        "command": shlex.join(["earl-jax", "train", "--config", str(run.path), "--out", "runs/again"]),
        "config": json.dumps(whole, indent=2, ensure_ascii=False),
        "engine": str(whole.get("engine", UNKNOWN)),
        "device": provenance(run)["device"],
    }
