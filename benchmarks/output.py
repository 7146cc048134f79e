"""How every benchmark leaves its result: a json with the command that made it and the versions it ran on."""

import json
from pathlib import Path
from typing import Any

from earl_jax.runs.provenance import provenance


def tell(report: dict[str, Any], path: Path | None, command: str) -> None:
    """Print `report` as one JSON line and save it to `path`, where there is one."""
    print(json.dumps(report))
    if path:
        save(path, command, report)


def save(path: Path, command: str, report: dict[str, Any]) -> None:
    """Write `report` to `path`, the `command` before it and versions, platform and commit behind it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({"command": command, **report, "provenance": provenance()}, indent=1) + "\n")
