"""Where the numbers of a page come from: options, commands that repeat a run, versions and machines."""

import dataclasses
import datetime
import json
import shlex
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from earl_jax.envs import make
from earl_jax.protocol import Deployment
from earl_jax.report.html.runs import Line, Run
from earl_jax.report.html.text import date_text, option_text, steps_text
from earl_jax.runs.config import RunConfig

MACHINE = ("python", "backend", "device", "commit")
"""Names in the provenance besides versions of packages."""
UNKNOWN = "unknown"


def run_card(line: Line, run: Run) -> dict[str, Any]:
    """Return the card of one run: its length, its options, the command that repeats it, its whole config."""
    config = run.config
    return {
        "line": line,
        "path": str(run.path),
        "env": config.env,
        "seeds": len(config.seeds),
        "steps": steps_text(config.steps),
        "changed": changed_options(line),
        "settings": settings(config),
        "command": command(config),
        "config": json.dumps(run.config_json, indent=2, ensure_ascii=False),
        "engine": str(run.config_json.get("engine", UNKNOWN)),
        "device": provenance(run)["device"],
    }


def changed_options(line: Line) -> list[tuple[str, str]]:
    """Return the options of a line that differ from the defaults, by name."""
    return [(name, option_text(value)) for name, value in sorted(line.curves.options.items())]


def settings(config: RunConfig) -> list[dict[str, Any]]:
    """Return every setting of a run, changed ones first: `of` which part, `name`, `value`, whether `changed`."""
    method = config.build_method()
    parts = {
        "task": (make(config.env, **config.env_options), config.env_options),
        "setting": (config.build_setting(), config.setting),
        "method": (method, config.options),
        "learner": (method.sac, config.options),
    }
    rows = []
    for kind, (part, changed) in parts.items():
        for field in dataclasses.fields(part):
            if field.name != "sac":
                value = option_text(getattr(part, field.name))
                rows.append({"of": kind, "name": field.name, "value": value, "changed": field.name in changed})
    return sorted(rows, key=lambda row: not row["changed"])


def command(config: RunConfig) -> str:
    """Return the command that trains the run again, or a Python call if its seeds are not 0 upwards."""
    setting = {name: value for name, value in config.setting.items() if name != "name"}
    options = {**config.env_options, **setting, **config.options}
    counts = {name: getattr(config, name) for name in ("steps", "eval_every", "eval_episodes", "checkpoint_every")}
    name = config.setting.get("name", Deployment.name)
    if config.seeds != tuple(range(len(config.seeds))):
        keywords = {"setting": name, "seeds": list(config.seeds), **counts, **options}
        arguments = ", ".join(f"{key}={value!r}" for key, value in keywords.items())
        return f"earl_jax.train({config.env!r}, {config.algo!r}, {arguments})"
    words = ["earl-jax", "train", config.env, "--algo", config.algo, "--seeds", str(len(config.seeds))]
    for key, value in counts.items():
        words += [f"--{key.replace('_', '-')}", str(value)]
    words += ["--setting", name] if name != Deployment.name else []
    words += ["--set", *(f"{key}={json.dumps(value)}" for key, value in options.items())] if options else []
    return shlex.join([*words, "--out", f"runs/{config.env}/{config.algo}"])


def provenance(run: Run) -> dict[str, str]:
    """Return the machine and the version of each package from a run's config, as texts; `unknown` for what it lacks."""
    recorded = run.config_json.get("provenance")
    recorded = recorded if isinstance(recorded, dict) else {}
    versions = recorded.get("versions")
    versions = versions if isinstance(versions, dict) else {}
    values = {name: recorded.get(name) for name in MACHINE} | versions
    return {str(name): UNKNOWN if value is None else str(value) for name, value in values.items()}


def origins(runs: Sequence[Run]) -> dict[str, Any]:
    """Return the distinct origins of `runs`: a column per origin, a row per name, and the names that differ."""
    groups: dict[tuple[tuple[str, str], ...], list[Run]] = {}
    for run in runs:
        groups.setdefault(tuple(sorted(provenance(run).items())), []).append(run)
    columns = [(dict(key), members) for key, members in groups.items()]
    names = list(dict.fromkeys(name for run in runs for name in provenance(run)))
    rows = []
    for name in names:
        values = [column.get(name, UNKNOWN) for column, _ in columns]
        rows.append({"name": name, "values": values, "differs": len(set(values)) > 1})
    heads = [{"count": len(members), "paths": [str(run.path) for run in members]} for _, members in columns]
    return {"heads": heads, "rows": rows, "differing": [row["name"] for row in rows if row["differs"]]}


def values_of(runs: Sequence[Run], name: str, text: Callable[[str], str] = str) -> str:
    """Return the distinct values of `name` in the provenance of `runs`, each as its `text`, in one line."""
    return ", ".join(dict.fromkeys(text(provenance(run).get(name, UNKNOWN)) for run in runs))


def date_range(runs: Sequence[Run]) -> str:
    """Return the days, in UTC, of the first start of `runs` and of their last evaluation."""
    moments = [moment for run in runs for moment in (_created(run), _modified(run.path / "metrics.csv"))]
    first, last = date_text(min(moments)), date_text(max(moments))
    return first if first == last else f"{first} to {last}"


def _created(run: Run) -> datetime.datetime:
    """Return when the run was created: by its config, or else by the time of that file."""
    try:
        return datetime.datetime.fromisoformat(run.config_json["provenance"]["created"]).astimezone(datetime.UTC)
    except (KeyError, TypeError, ValueError):
        return _modified(run.path / "config.json")


def _modified(path: Path) -> datetime.datetime:
    return datetime.datetime.fromtimestamp(path.stat().st_mtime, datetime.UTC)


def report_command(folders: Sequence[Path], out: Path, videos: bool) -> str:
    """Return the command that makes the page again."""
    return shlex.join(["earl-jax", "report", *map(str, folders), "--out", str(out), *["--videos"] * videos])
