"""SIGKILL at random moments: `python -m benchmarks.kills --kills 50 --out benchmarks/results/kills/kills.json`.

A small run that writes a checkpoint at every evaluation is started, killed after a random time, started again (`earl-jax
resume`, or `train` where it had not got as far as a config) and so on until it ends; then comes the next run. Each has to
end with the table of a run that nobody touched, byte for byte, and with its last checkpoint whole. Writes a row a kill
beside the json.
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

from benchmarks.output import tell
from earl_jax.runs import checkpoint

RUN = [
    "--seeds", "2", "--steps", "800", "--eval-every", "40", "--eval-episodes", "2", "--checkpoint-every", "40",
    "--set", "hidden_sizes=[16,16]", "batch_size=16", "random_steps=40",
]  # fmt: skip
CLI = [sys.executable, "-m", "earl_jax.cli"]
FIELDS = ["run", "command", "seconds", "rows", "newest", "writing"]


def started(folder: Path) -> subprocess.Popen:
    """Return a process that begins the run in `folder`, or goes on with it."""
    begin = ["train", "tabletop_organization", "--algo", "fbrl", "--out", str(folder), *RUN]
    arguments = ["resume", str(folder)] if (folder / "config.json").is_file() else begin
    return subprocess.Popen([*CLI, *arguments], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


def ended(process: subprocess.Popen, seconds: float | None = None) -> bool:
    """Return whether `process` ended well before it was killed, after `seconds`; one that ends badly is a RuntimeError."""
    try:
        _, told = process.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
        return False
    if process.returncode:
        raise RuntimeError(f"ended with {process.returncode}: {told}")
    return True


def left(folder: Path) -> dict[str, Any]:
    """Return what a killed process left behind."""
    table, checkpoints = folder / "metrics.csv", folder / "checkpoints"
    rows = len(table.read_text().splitlines()) - 1 if table.exists() else 0
    return {
        "rows": max(rows, 0),
        "newest": checkpoint.newest(checkpoints),
        "writing": any(checkpoints.glob("part-*")) or (folder / "config.json.part").exists(),
    }


def measure(count: int, seed: int, root: Path) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Return a row for each of `count` kills, and what became of the runs."""
    whole, chance, kills = root / "whole", random.Random(seed), []
    ended(started(whole))  # compiles
    again = root / "again"
    began = time.monotonic()
    ended(started(again))
    longest, runs, equal = time.monotonic() - began, 0, 0
    while len(kills) < count:
        folder = root / f"run{runs}"
        runs += 1
        while True:
            command, seconds = "resume" if (folder / "config.json").is_file() else "train", chance.uniform(0, longest)
            patience = seconds if len(kills) < count else None
            if ended(started(folder), patience):
                break
            kills.append({"run": runs, "command": command, "seconds": round(seconds, 3), **left(folder)})
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
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as root:
        kills, summary = measure(asked.kills, asked.seed, Path(root))
    out = f" --out {asked.out}" if asked.out else ""
    tell(summary, asked.out, f"python -m benchmarks.kills --kills {asked.kills} --seed {asked.seed}{out}")
    if asked.out:
        with asked.out.with_suffix(".csv").open("w", newline="") as handle:
            writer = csv.DictWriter(handle, FIELDS, lineterminator="\n")
            writer.writeheader()
            writer.writerows(kills)
    if summary["equal_tables"] < summary["runs"]:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
