"""Where the numbers of a page come from: options, commands that repeat a run, versions and machines."""

import json
import shlex
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from earl_jax.protocol import Deployment
from earl_jax.report.html.lines import Line, recorded
from earl_jax.report.tables import steps_text
from earl_jax.runs.config import RunConfig
from earl_jax.runs.folder import RunFolder

MACHINE = ("python", "backend", "device", "commit")
"""Names in the provenance besides versions of packages."""
UNKNOWN = "unknown"


def run_card(line: Line, run: RunFolder) -> dict[str, Any]:
    """Return the card of one run: its length, its options, the command that repeats it, its whole config."""
    config, whole = run.config, recorded(run)
    return {
        "line": line,
        "path": str(run.path),
        "env": config.env,
        "seeds": len(config.seeds),
        "steps": steps_text(config.steps),
        "changed": changed_options(line),
        "command": command(config),
        "config": json.dumps(whole, indent=2, ensure_ascii=False),
        "engine": str(whole.get("engine", UNKNOWN)),
        "device": provenance(run)["device"],
    }


def changed_options(line: Line) -> list[tuple[str, str]]:
    """Return the options of a line that differ from the defaults, by name."""
    return [(name, option_text(value)) for name, value in sorted(line.curves.options.items())]


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


def provenance(run: RunFolder) -> dict[str, str]:
    """Return the machine and the version of each package from a run's config, as texts; `unknown` for what it lacks."""
    known = recorded(run).get("provenance")
    known = known if isinstance(known, dict) else {}
    versions = known.get("versions")
    values = {name: known.get(name) for name in MACHINE} | (versions if isinstance(versions, dict) else {})
    return {str(name): UNKNOWN if value is None else str(value) for name, value in values.items()}


def origins(runs: Sequence[RunFolder]) -> dict[str, Any]:
    """Return the distinct origins of `runs`: a column per origin, a row per name, and the names that differ."""
    groups: dict[tuple[tuple[str, str], ...], list[RunFolder]] = {}
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


def values_of(runs: Sequence[RunFolder], name: str, text: Callable[[str], str] = str) -> str:
    """Return the distinct values of `name` in the provenance of `runs`, each as its `text`, in one line."""
    return ", ".join(dict.fromkeys(text(provenance(run).get(name, UNKNOWN)) for run in runs))


def report_command(folders: Sequence[Path], out: Path, videos: bool) -> str:
    """Return the command that makes the page again."""
    return shlex.join(["earl-jax", "report", *map(str, folders), "--out", str(out), *["--videos"] * videos])


def option_text(value: Any) -> str:
    """Return the value of an option as JSON, a string without its quotes."""
    if isinstance(value, str):
        return value
    return json.dumps(np.asarray(value).tolist() if hasattr(value, "shape") else value, default=str)
