"""What every peer's script shares: its options, its clock, where side-by-side processes meet, and the row it prints."""

import argparse
import json
import os
import platform
import statistics
import time
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from typing import Any

from benchmarks.peers import BEGAN

TABLETOP, DOOR = "tabletop_organization", "sawyer_door"
HIDDEN, BATCH, CAPACITY, LEARNING_RATE = (256, 256), 256, 100_000, 3e-4
"""Nets, batch, replay rows a seed and Adam's step size of every side, where its row's note doesn't say otherwise."""
HORIZON = 200
"""Steps of an attempt at the tabletop task."""
MEET_S = 120.0
"""Seconds that a process waits for the others."""


def options(description: str | None, **extra: dict[str, Any]) -> argparse.Namespace:
    """Return the options of a peer's script; `extra` are its own, name to what `add_argument` takes."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--lanes", type=int, default=1, help="seeds in this process")
    parser.add_argument("--steps", type=int, default=100, help="steps of each seed in one timed repeat")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--meet", type=Path, help="a folder in which side-by-side processes wait for each other")
    parser.add_argument("--processes", type=int, default=1, help="how many of them there are")
    parser.add_argument("--number", type=int, default=0, help="which of them this is; it takes its share of the cores")
    for name, keywords in extra.items():
        parser.add_argument(f"--{name}", **keywords)
    chosen = parser.parse_args()
    share_cores(chosen.number, chosen.processes)
    return chosen


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def share_cores(number: int, processes: int) -> None:
    """Pin this process to the `number`-th part of the cores, so that side-by-side processes don't fight for them."""
    if processes == 1 or not hasattr(os, "sched_setaffinity"):
        return
    cores = sorted(os.sched_getaffinity(0))
    width = max(1, len(cores) // processes)
    first = number * width % len(cores)
    os.sched_setaffinity(0, cores[first : first + width])


def meet(chosen: argparse.Namespace) -> None:
    """Wait until all side-by-side processes have come here, or at most `MEET_S`."""
    if chosen.meet is None:
        return
    (chosen.meet / str(chosen.number)).touch()
    until = time.monotonic() + MEET_S
    while len(list(chosen.meet.iterdir())) < chosen.processes:
        if time.monotonic() > until:
            raise TimeoutError(
                f"of {chosen.processes} processes only {len(list(chosen.meet.iterdir()))} came to be timed"
            )
        time.sleep(0.005)


def median_s(advance: Callable[[], Any], repeats: int) -> float:
    """Return the median seconds of `repeats` calls of `advance`, which ends when its work is done."""
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        advance()
        times.append(time.perf_counter() - began)
    return statistics.median(times)


def since_start() -> float:
    """Return the seconds since this process came to the peers' package."""
    return time.perf_counter() - BEGAN


def version_of(package: str) -> str | None:
    """Return the installed version of `package`, or None for one that runs from a checkout."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def tell(packages: tuple[str, ...], **row: Any) -> None:
    """Print `row` as one JSON line, rounded, with the versions of `packages` and of Python."""
    versions = {"python": platform.python_version(), **{name: version_of(name) for name in packages}}
    row = {name: round(value, 2) if isinstance(value, float) else value for name, value in row.items()}
    print(json.dumps({**row, "versions": versions}), flush=True)
