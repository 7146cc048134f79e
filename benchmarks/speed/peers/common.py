"""Shared by the scripts of all peers: options, clock, a barrier for parallel processes, and the printed row."""

import argparse
import json
import os
import platform
import statistics
import time
import timeit
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from typing import Any

from benchmarks.speed.peers import BEGAN
from earl_jax.options.environment import own_cores

TABLETOP, DOOR = "tabletop_organization", "sawyer_door"
HIDDEN, BATCH, CAPACITY, LEARNING_RATE = (256, 256), 256, 100_000, 3e-4
"""Networks, batch, replay rows per seed and Adam's step size of every script, unless the note of its row gives others."""
HORIZON = 200
"""Steps of an attempt at the tabletop task."""
BARRIER_S = 120.0
"""Seconds that a process waits for the others."""


def options(description: str | None, **extra: dict[str, Any]) -> argparse.Namespace:
    """Return the options of a peer's script; `extra` has its own, from names to keywords of `add_argument`."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--lanes", type=int, default=1, help="seeds in this process")
    parser.add_argument("--steps", type=int, default=100, help="steps of each seed in one timed repeat")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--meet", type=Path, help="a folder in which parallel processes wait for each other")
    parser.add_argument("--processes", type=int, default=1, help="the number of parallel processes")
    parser.add_argument(
        "--number", type=int, default=0, help="the number of this process, which gets its share of the cores"
    )
    for name, keywords in extra.items():
        parser.add_argument(f"--{name}", **keywords)
    chosen = parser.parse_args()
    share_cores(chosen.number, chosen.processes)
    return chosen


def share_cores(number: int, processes: int) -> None:
    """Pin this process to the `number`-th part of the cores, so that parallel processes don't compete for them."""
    if processes == 1 or not hasattr(os, "sched_setaffinity"):
        return
    cores = own_cores()
    width = max(1, len(cores) // processes)
    first = number * width % len(cores)
    os.sched_setaffinity(0, cores[first : first + width])


def wait_for_others(chosen: argparse.Namespace) -> None:
    """Wait until all parallel processes have called this, for at most `BARRIER_S`."""
    if chosen.meet is None:
        return
    (chosen.meet / str(chosen.number)).touch()
    until = time.monotonic() + BARRIER_S
    while len(list(chosen.meet.iterdir())) < chosen.processes:
        if time.monotonic() > until:
            raise TimeoutError(
                f"only {len(list(chosen.meet.iterdir()))} of {chosen.processes} processes are ready to be timed"
            )
        time.sleep(0.005)


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
    print(json.dumps({"processes": 1, **row, "versions": versions}), flush=True)
