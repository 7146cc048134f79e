"""Kill runs at random times: `python -m benchmarks.kills --kills 50 --out benchmarks/results/kills/kills.json`.

A small run that writes a checkpoint at every evaluation is started, gets SIGKILL after a random time, is started again
(`earl-jax resume`, or `train` if it has no config yet; a sweep or a reproduction by the same command) and so on until it ends.
Then the next run starts. Every run must end with the tables of an uninterrupted run, byte for byte, and with intact last
checkpoints. A kill hits the launcher of a sweep alone: its worker must end with it. Writes a row per kill beside the json.
"""

import dataclasses
import math
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import tyro

from benchmarks.output import emit
from earl_jax import list_algos
from earl_jax.report.tables import csv_text
from earl_jax.runs import archive, checkpoint

TINY = ["hidden_sizes=[16,16]", "batch_size=16", "random_steps=40"]
CLI = [sys.executable, "-m", "earl_jax.cli"]
PATIENCE = 10.0
"""Seconds after which a worker counts as one that does not end with its launcher."""
OWN = {"vaprl": ["refresh_every=40", "value_samples=2"]}
"""Options of a method that make its run short."""
GRID = """
envs = ["tabletop_organization"]
algos = ["naive", "fbrl"]
seeds = 2
steps = 400
eval_every = 40
eval_episodes = 2
checkpoint_every = 40
[options]
hidden_sizes = [[16, 16]]
batch_size = 16
random_steps = 40
reward_scale = [1, 10]
"""


@dataclasses.dataclass(frozen=True)
class Subject:
    """What is killed: a run of `arguments` of `train`, or with `repeated` a command that continues what it finds."""

    name: str
    arguments: tuple[str, ...]
    repeated: bool = False

    def command(self, folder: Path) -> tuple[str, ...]:
        """Return the command that starts or continues this in `folder`."""
        if not self.repeated and (folder / "config.json").is_file():
            return "resume", str(folder)
        return *self.arguments, "--out", str(folder)


def training(name: str, task: str, algo: str, steps: int, options: list[str], *others: str) -> Subject:
    """Return a run with twenty evaluations, a checkpoint at each."""
    every = str(steps // 20)
    lengths = ["--steps", str(steps), "--eval-every", every, "--checkpoint-every", every, "--eval-episodes", "2"]
    return Subject(name, ("train", task, "--algo", algo, "--seeds", "2", *lengths, *others, "--set", *TINY, *options))


def all_subjects(root: Path) -> dict[str, Subject]:
    """Return all subjects by name; `root` receives the grid of the sweep."""
    grid, table = root / "grid.toml", "tabletop_organization"
    grid.write_text(GRID)
    every = [
        *(training(algo, table, algo, 800, OWN.get(algo, [])) for algo in list_algos()),
        training("door", "sawyer_door", "fbrl", 400, ["eval_horizon=40"], "--engine", "c"),
        training("peg", "sawyer_peg", "fbrl", 400, ["eval_horizon=40"], "--engine", "c"),
        training("budget", table, "fbrl", 800, ["budget=5", "intervention_chance=0.01"], "--setting", "continuing"),
        Subject("sweep", ("sweep", str(grid)), repeated=True),
        Subject("reproduce", ("reproduce", "table1", "--steps", "400"), repeated=True),
    ]
    return {subject.name: subject for subject in every}


def start(subject: Subject, folder: Path) -> subprocess.Popen:
    """Return a process that starts or continues `subject` in `folder`."""
    return subprocess.Popen(
        [*CLI, *subject.command(folder)], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )


def children(pid: int) -> list[int]:
    """Return the processes that `pid` has started, which are alive."""
    try:
        return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    except OSError:
        return []


def alive(pid: int) -> bool:
    """Return whether the process `pid` runs; a zombie does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


def kill(process: subprocess.Popen) -> float:
    """Kill `process` and return the seconds for which its children outlive it.

    Raises:
        RuntimeError: one of them does not end.
    """
    left = children(process.pid)
    process.send_signal(signal.SIGKILL)
    began = time.monotonic()
    while any(map(alive, left)):
        if time.monotonic() - began > PATIENCE:
            raise RuntimeError(f"a child outlived its launcher by more than {PATIENCE} s")
        time.sleep(0.001)
    seconds = time.monotonic() - began
    process.communicate()
    return round(seconds, 3)


def finished(process: subprocess.Popen, seconds: float | None = None) -> tuple[bool, float]:
    """Return whether `process` ended without an error before it is killed after `seconds`, and what `kill` returns.

    Raises:
        RuntimeError: it ended with an error.
    """
    try:
        _, err = process.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        return False, kill(process)
    if process.returncode:
        raise RuntimeError(f"ended with {process.returncode}: {err}")
    return True, 0.0


def tables(folder: Path) -> dict[str, bytes]:
    """Return the tables of all runs in `folder`, by their paths."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("metrics.csv"))}


def describe(folder: Path) -> dict[str, Any]:
    """Return what is in `folder` after a kill: of a sweep, the rows of all runs and the newest checkpoint of any."""
    checkpoints = list(folder.rglob("checkpoints"))
    return {
        "rows": sum(max(0, len(table.splitlines()) - 1) for table in tables(folder).values()),
        "newest": max(map(checkpoint.newest, checkpoints), default=0),
        "writing": any(folder.rglob("*.part")),
    }


def measure(subject: Subject, count: int, seed: int, root: Path) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Return a row for each of `count` kills of `subject`, and a summary of the runs."""
    whole, rng, kills = root / "whole", random.Random(seed), []
    finished(start(subject, whole))  # compiles
    began = time.monotonic()
    finished(start(subject, root / "again"))
    longest, runs, equal = time.monotonic() - began, 0, 0
    while len(kills) < count:
        folder = root / f"run{runs}"
        runs += 1
        while True:
            command, seconds = subject.command(folder)[0], rng.uniform(0, longest)
            done, outlived = finished(start(subject, folder), seconds if len(kills) < count else None)
            if done:
                break
            row = {"subject": subject.name, "run": runs, "command": command, "seconds": round(seconds, 3)}
            kills.append({**row, **describe(folder), "outlived": outlived})
            print(kills[-1], flush=True)
        equal += tables(folder) == tables(whole)
        for checkpoints in folder.rglob("checkpoints"):
            archive.read(checkpoints, checkpoint.newest(checkpoints), {"lanes": math.inf, "replay": math.inf})
    summary = {
        "subject": subject.name, "kills": len(kills), "in_a_write": sum(kill["writing"] for kill in kills), "runs": runs,
        "equal_tables": equal, "longest_outlived_s": max(kill["outlived"] for kill in kills),
        "seconds_of_a_run": round(longest, 1),
    }  # fmt: skip
    return kills, summary


def main(kills: int = 50, seed: int = 0, subjects: tuple[str, ...] = ("fbrl",), out: Path | None = None) -> None:
    """Kill each subject so many times, compare, and write both files."""
    rows, summaries = [], []
    with tempfile.TemporaryDirectory() as root:
        every = all_subjects(Path(root))
        for name in subjects:
            killed, summary = measure(every[name], kills, seed, Path(root, name))
            rows += killed
            summaries.append(summary)
    emit({"seed": seed, "subjects": summaries}, out)
    if out:
        out.with_suffix(".csv").write_text(csv_text(rows))
    if any(summary["equal_tables"] < summary["runs"] for summary in summaries):
        raise SystemExit(1)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
