"""Where the numbers of a page come from: options, commands that repeat a run, versions and machines."""

import dataclasses
import datetime
import json
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from earl_jax.envs import make
from earl_jax.protocol import Deployment
from earl_jax.report.html.runs import Line, Run
from earl_jax.report.html.tables import steps_said
from earl_jax.runs.config import RunConfig

MACHINE = ("python", "backend", "device", "commit")
"""What provenance says besides versions."""


def run_card(line: Line, run: Run) -> dict[str, Any]:
    """Return what the page says of one run: how long it lived, its options, the command that repeats it, its whole config."""
    one = run.config
    return {
        "line": line,
        "path": str(run.path),
        "env": one.env,
        "seeds": len(one.seeds),
        "steps": steps_said(one.steps),
        "changed": changed(line),
        "settings": settings(one),
        "command": command(one),
        "config": json.dumps(run.config_json, indent=2, ensure_ascii=False),
        "engine": str(run.config_json.get("engine", "unknown")),
        "device": provenance(run)["device"],
    }


def changed(line: Line) -> list[tuple[str, str]]:
    """Return the options of a line that differ from the defaults, by name."""
    return [(name, plainly(value)) for name, value in sorted(line.cell.curves.options.items())]


def plainly(value: Any) -> str:
    """Return the value of an option as JSON, a text without its quotes."""
    if isinstance(value, str):
        return value
    return json.dumps(np.asarray(value).tolist() if hasattr(value, "shape") else value, default=str)


def settings(one: RunConfig) -> list[dict[str, Any]]:
    """Return every setting of a run, `of` what, `name`, `value` and whether it was `changed`, those that were first."""
    method = one.build_method()
    parts = {
        "task": make(one.env, **one.env_options),
        "setting": one.build_setting(),
        "method": method,
        "learner": method.sac,
    }
    asked = {"task": one.env_options, "setting": one.setting, "method": one.options, "learner": one.options}
    rows = []
    for kind, part in parts.items():
        for field in dataclasses.fields(part):
            if field.name != "sac":
                value = plainly(getattr(part, field.name))
                rows.append({"of": kind, "name": field.name, "value": value, "changed": field.name in asked[kind]})
    return sorted(rows, key=lambda row: not row["changed"])


def command(one: RunConfig) -> str:
    """Return the command that trains the run again, or a call from Python where its seeds are not 0 upwards."""
    setting = {name: value for name, value in one.setting.items() if name != "name"}
    options = {**one.env_options, **setting, **one.options}
    counts = {name: getattr(one, name) for name in ("steps", "eval_every", "eval_episodes", "checkpoint_every")}
    name = one.setting.get("name", Deployment.name)
    if one.seeds != tuple(range(len(one.seeds))):
        given = {"setting": name, "seeds": list(one.seeds), **counts, **options}
        told = ", ".join(f"{key}={value!r}" for key, value in given.items())
        return f"earl_jax.train({one.env!r}, {one.algo!r}, {told})"
    words = ["earl-jax", "train", one.env, "--algo", one.algo, "--seeds", str(len(one.seeds))]
    for key, value in counts.items():
        words += [f"--{key.replace('_', '-')}", str(value)]
    words += ["--setting", name] if name != Deployment.name else []
    words += ["--set", *(f"{key}={json.dumps(value)}" for key, value in options.items())] if options else []
    return shlex.join([*words, "--out", f"runs/{one.env}/{one.algo}"])


def provenance(run: Run) -> dict[str, str]:
    """Return what a run's config says of its machine, and the version of each package, as texts; `unknown` where it is silent."""
    said = run.config_json.get("provenance")
    said = said if isinstance(said, dict) else {}
    versions = said.get("versions")
    versions = versions if isinstance(versions, dict) else {}
    found = {name: said.get(name) for name in MACHINE} | versions
    return {str(name): "unknown" if value is None else str(value) for name, value in found.items()}


def origins(runs: Sequence[Run]) -> dict[str, Any]:
    """Return the distinct machines and versions of `runs`: a column each with how many runs, a row a thing, and what differs."""
    groups: dict[tuple[tuple[str, str], ...], list[Run]] = {}
    for run in runs:
        groups.setdefault(tuple(sorted(provenance(run).items())), []).append(run)
    columns = [(dict(key), members) for key, members in groups.items()]
    names = list(dict.fromkeys(name for run in runs for name in provenance(run)))
    rows = []
    for name in names:
        values = [column.get(name, "unknown") for column, _ in columns]
        rows.append({"name": name, "values": values, "differs": len(set(values)) > 1})
    heads = [{"count": len(members), "paths": [str(run.path) for run in members]} for _, members in columns]
    return {"heads": heads, "rows": rows, "differing": [row["name"] for row in rows if row["differs"]]}


def values_of(runs: Sequence[Run], name: str, length: int | None = None) -> str:
    """Return the distinct values that the provenance of `runs` has of `name`, cut to `length`, in one line."""
    return ", ".join(dict.fromkeys(provenance(run).get(name, "unknown")[:length] for run in runs))


def dated(runs: Sequence[Run]) -> str:
    """Return the days on which `runs` began and on which they wrote last, in UTC; where a config does not say, its file does."""
    days = [moment for run in runs for moment in (_born(run), _written(run.path / "metrics.csv"))]
    first, last = day(min(days)), day(max(days))
    return first if first == last else f"{first} to {last}"


def _born(run: Run) -> datetime.datetime:
    try:
        return datetime.datetime.fromisoformat(run.config_json["provenance"]["created"]).astimezone(datetime.UTC)
    except (KeyError, TypeError, ValueError):
        return _written(run.path / "config.json")


def _written(path: Path) -> datetime.datetime:
    return datetime.datetime.fromtimestamp(path.stat().st_mtime, datetime.UTC)


def day(when: datetime.datetime) -> str:
    """Return a date for people: 3 May 2026."""
    return f"{when.day} {when:%B %Y}"


def repeat(folders: Sequence[Path], out: Path) -> str:
    """Return the command that makes the page again."""
    return shlex.join(["earl-jax", "report", *map(str, folders), "--out", str(out)])
