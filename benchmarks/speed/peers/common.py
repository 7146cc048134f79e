"""Shared by the scripts of all peers: options, clock, and the printed row."""

import argparse
import json
import platform
import statistics
import time
import timeit
from collections.abc import Callable
from importlib import metadata
from typing import Any

from benchmarks.speed.peers import BEGAN

TABLETOP, DOOR = "tabletop_organization", "sawyer_door"
HIDDEN, BATCH, CAPACITY, LEARNING_RATE = (256, 256), 256, 100_000, 3e-4
"""Networks, batch, replay rows per seed and Adam's step size of every script, unless the note of its row gives others."""
HORIZON = 200
"""Steps of an attempt at the tabletop task."""


def options(description: str | None, **extra: dict[str, Any]) -> argparse.Namespace:
    """Return the options of a peer's script; `extra` has its own, from names to keywords of `add_argument`."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--lanes", type=int, default=1, help="seeds in this process")
    parser.add_argument("--steps", type=int, default=100, help="steps of each seed in one timed repeat")
    parser.add_argument("--repeats", type=int, default=3)
    for name, keywords in extra.items():
        parser.add_argument(f"--{name}", **keywords)
    return parser.parse_args()


def median_s(advance: Callable[[], Any], repeats: int) -> float:
    """Return the median seconds of `repeats` calls of `advance`, which returns when its work is done."""
    return statistics.median(timeit.repeat(advance, number=1, repeat=repeats))


def since_start() -> float:
    """Return the seconds since this process imported the package of peers."""
    return time.perf_counter() - BEGAN


def version_of(package: str) -> str | None:
    """Return the installed version of `package`, or None if it runs from a checkout."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def emit(packages: tuple[str, ...], **row: Any) -> None:
    """Print the `row` of one process as one JSON line, rounded, with the versions of `packages` and of Python."""
    versions = {"python": platform.python_version(), **{name: version_of(name) for name in packages}}
    row = {name: round(value, 2) if isinstance(value, float) else value for name, value in row.items()}
    print(json.dumps({**row, "versions": versions}), flush=True)
