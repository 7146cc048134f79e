"""The result of a benchmark: a JSON file with the command that made it and the versions it ran on."""

import json
from pathlib import Path
from typing import Any

from earl_jax.runs.provenance import provenance

RESULTS = Path(__file__).parent / "results"


def emit(report: dict[str, Any], path: Path | None, command: str) -> None:
    """Print `report` as one JSON line, and save it to `path` unless that is None."""
    print(json.dumps(report))
    if path:
        save(path, command, report)


def save(path: Path, command: str, report: dict[str, Any]) -> None:
    """Write the `command`, `report`, and versions, platform and commit to `path`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({"command": command, **report, "provenance": provenance()}, indent=1) + "\n")
