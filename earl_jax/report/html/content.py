"""The content of a page, as texts and numbers that its template and its script lay out."""

import datetime
from collections.abc import Sequence
from typing import Any

from earl_jax.report.html.curves import POINTS, panels
from earl_jax.report.html.leaderboard import leaderboard
from earl_jax.report.html.lines import Line
from earl_jax.report.html.media import VideoEmbedder, maps
from earl_jax.report.html.origin import changed_options, origins, run_card, values_of
from earl_jax.report.html.page_tables import paper_table, seed_table
from earl_jax.report.html.policy_videos import PolicyVideos
from earl_jax.report.published import INTERVAL_RULE
from earl_jax.report.scores import WINDOW
from earl_jax.report.style import task_order, task_title
from earl_jax.report.tables import steps_text
from earl_jax.runs.folder import RunFolder
from earl_jax.runs.provenance import short_commit

CROWD = 6
"""Above this number of lines, a task's bands are hidden at first."""


def page_content(lines: Sequence[Line], policies: PolicyVideos | None = None) -> dict[str, Any]:
    """Return the variables of the template for `lines`, with videos of their `policies`."""
    embedder = VideoEmbedder(policies)
    runs = [run for line in lines for run in line.runs]
    titles = [task_title(env) for env in task_order(line.group.env for line in lines)]
    sections = enumerate(_by_section(lines).items())
    tasks = [_task_section(f"t{number}", title, members, embedder) for number, (title, members) in sections]
    return {
        "heading": ", ".join(titles[:3]) + (f" and {len(titles) - 3} more" if len(titles) > 3 else ""),
        "tasks": tasks,
        "lines": lines,
        "facts": _facts(lines, runs),
        "paper_tables": [paper_table(number, lines) for number in (1, 2)],
        "rule": INTERVAL_RULE,
        "leaderboard": leaderboard(lines),
        "cards": [run_card(line, run) for line in lines for run in line.runs],
        "origins": origins(runs),
        "window": WINDOW,
    }


def plot_numbers(content: dict[str, Any]) -> dict[str, Any]:
    """Return the part of `page_content` from which the script draws plots, as plain JSON."""
    return {
        task["id"]: {
            "styles": {line.key: {"label": line.group.label, "dash": line.dash} for line in task["lines"]},
            "panels": task["panels"],
            "maps": [{**visit_map, "line": visit_map["line"].key} for visit_map in task["maps"]],
        }
        for task in content["tasks"]
    }


def _facts(lines: Sequence[Line], runs: Sequence[RunFolder]) -> list[tuple[str, str]]:
    seeds = sum(len(line.seeds) for line in lines)
    steps = sum(int(line.curves.steps[-1]) * len(line.seeds) for line in lines)
    versions = {"earl-jax": "earl-jax", "jax": "jax", "Python": "python"}
    return [
        ("Runs", f"{len(runs)}, with {seeds} seeds and {steps_text(steps)} steps in total"),
        ("Methods", ", ".join(dict.fromkeys(line.group.algo for line in lines))),
        ("Date", f"this page, {datetime.datetime.now(datetime.UTC):%Y-%m-%d}; each run has its own in its config.json"),
        ("Hardware", values_of(runs, "device")),
        ("Versions", "; ".join(f"{name} {values_of(runs, key)}" for name, key in versions.items())),
        ("Commit", values_of(runs, "commit", short_commit)),
    ]


def _by_section(lines: Sequence[Line]) -> dict[str, list[Line]]:
    """Return the lines of each task by its title, those scored by success apart from those scored by return."""
    groups: dict[tuple[str, str], list[Line]] = {}
    for line in lines:
        groups.setdefault((line.group.env, line.curves.deployed_metric), []).append(line)
    envs = [env for env, _ in groups]
    return {
        task_title(env) + (f", scored by {metric.removeprefix('deployed/')}" if envs.count(env) > 1 else ""): members
        for (env, metric), members in groups.items()
    }


def _task_section(key: str, title: str, lines: Sequence[Line], embedder: VideoEmbedder) -> dict[str, Any]:
    """Return everything that the page shows of one task."""
    plots, (visit_maps, map_notes) = panels(lines), maps(lines)
    videos = [embedder.videos(line) for line in lines]
    curves = [curve for plot in plots for curve in plot["lines"]]
    longest = max(len(line.curves.steps) for line in lines)
    return {
        "id": key,
        "env": lines[0].group.env,
        "title": title,
        "lines": lines,
        "options": [(line, changed_options(line)) for line in lines],
        "notes": _notes(lines),
        "panels": plots,
        "smooth": any(curve["smooth"] for curve in curves),
        "banded": any(curve["plain"]["low"] for curve in curves),
        "published": any(curve["published"] for curve in curves),
        "crossed": any(curve["published"]["crossings"] for curve in curves if curve["published"]),
        "crowded": len(lines) > CROWD,
        "thinned": (POINTS, longest) if longest > POINTS else None,
        "seeds": seed_table(lines),
        "maps": visit_maps,
        "map_notes": map_notes,
        "videos": [video for embedded, _ in videos for video in embedded],
        "video_notes": [sentence for _, sentences in videos for sentence in sentences],
    }


def _notes(lines: Sequence[Line]) -> list[str]:
    """Return notes on one task's runs: unfinished ones, and seeds that count twice."""
    notes: list[str] = []
    for line in lines:
        trained, planned = int(line.curves.steps[-1]), max(run.config.steps for run in line.runs)
        if trained < planned:
            notes.append(f"{line.group.label}: {trained:,} of {planned:,} steps trained.")
        repeated = ", ".join(str(seed) for seed in sorted(set(line.seeds)) if line.seeds.count(seed) > 1)
        if repeated:
            notes.append(f"{line.group.label}: seed {repeated} was trained in several runs, and each of them counts.")
    return notes
