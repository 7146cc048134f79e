"""Kill runs at random times: `python -m benchmarks.kills --kills 50 --out benchmarks/results/kills/kills.json`.

A small run that writes a checkpoint at every evaluation is started, gets SIGKILL after a random time, is started again
(`earl-jax resume`, or `train` if it has no config yet) and so on until it ends. Then the next run starts. Every run must end
with the table of an uninterrupted run, byte for byte, and with an intact last checkpoint. Writes a row per kill beside the json.
"""

import argparse
import csv
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.output import emit
from earl_jax.runs import checkpoint

RUN = [
    "--seeds", "2", "--steps", "800", "--eval-every", "40", "--eval-episodes", "2", "--checkpoint-every", "40",
    "--set", "hidden_sizes=[16,16]", "batch_size=16", "random_steps=40",
]  # fmt: skip
CLI = [sys.executable, "-m", "earl_jax.cli"]
FIELDS = ["run", "command", "seconds", "rows", "newest", "writing"]


def start(folder: Path) -> subprocess.Popen:
    """Return a process that trains the run in `folder`, or resumes it."""
    train = ["train", "tabletop_organization", "--algo", "fbrl", "--out", str(folder), *RUN]
    arguments = ["resume", str(folder)] if (folder / "config.json").is_file() else train
    return subprocess.Popen([*CLI, *arguments], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


def finished(process: subprocess.Popen, seconds: float | None = None) -> bool:
    """Return whether `process` ended without an error before it is killed after `seconds`.

    Raises:
        RuntimeError: it ended with an error.
    """
    try:
        _, err = process.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
        return False
    if process.returncode:
        raise RuntimeError(f"ended with {process.returncode}: {err}")
    return True


def describe(folder: Path) -> dict[str, Any]:
    """Return what is in `folder` after a kill."""
    table, checkpoints = folder / "metrics.csv", folder / "checkpoints"
    rows = len(table.read_text().splitlines()) - 1 if table.exists() else 0
    return {
        "rows": max(rows, 0),
        "newest": checkpoint.newest(checkpoints),
        "writing": any(checkpoints.glob("part-*")) or (folder / "config.json.part").exists(),
    }


def measure(count: int, seed: int, root: Path) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Return a row for each of `count` kills, and a summary of the runs."""
    whole, rng, kills = root / "whole", random.Random(seed), []
    finished(start(whole))  # compiles
    again = root / "again"
    began = time.monotonic()
    finished(start(again))
    longest, runs, equal = time.monotonic() - began, 0, 0
    while len(kills) < count:
        folder = root / f"run{runs}"
        runs += 1
        while True:
            command, seconds = "resume" if (folder / "config.json").is_file() else "train", rng.uniform(0, longest)
            limit = seconds if len(kills) < count else None
            if finished(start(folder), limit):
                break
            kills.append({"run": runs, "command": command, "seconds": round(seconds, 3), **describe(folder)})
            print(kills[-1], flush=True)
        equal += (folder / "metrics.csv").read_bytes() == (whole / "metrics.csv").read_bytes()
        checkpoint.verified(folder / "checkpoints" / "000000800")
    summary = {
        "kills": len(kills), "in_a_write": sum(kill["writing"] for kill in kills), "runs": runs, "equal_tables": equal,
        "seconds_of_a_run": round(longest, 1), "seed": seed,
    }  # fmt: skip
    return kills, summary


def main() -> None:
    """Kill, compare, and write both files."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as root:
        kills, summary = measure(arguments.kills, arguments.seed, Path(root))
    out = f" --out {arguments.out}" if arguments.out else ""
    emit(summary, arguments.out, f"python -m benchmarks.kills --kills {arguments.kills} --seed {arguments.seed}{out}")
    if arguments.out:
        with arguments.out.with_suffix(".csv").open("w", newline="") as handle:
            writer = csv.DictWriter(handle, FIELDS, lineterminator="\n")
            writer.writeheader()
            writer.writerows(kills)
    if summary["equal_tables"] < summary["runs"]:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
