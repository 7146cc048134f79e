"""Compare the speed of earl_jax with other ways to train seeds, in one run on one machine:

    python -m benchmarks.speed.suite --install-peers            # once: .cache/peers, from benchmarks/speed/peers/requirements.txt
    python -m benchmarks.speed.suite                            # under 5 minutes on 2 cores

Prints the rows and the ratios between them, and writes results/speed/<machine>_peers.json and .csv. Every row is a separate
process: ours in this interpreter, the peers in that of `--peer-python`. A row that does not run has its reason instead.
"""

import dataclasses
import json
import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import jax
import tyro

from benchmarks.output import RESULTS, ROOT, save
from benchmarks.speed.peers.plan import Job, plan, ratios
from earl_jax.options.environment import own_cores
from earl_jax.report.tables import csv_text

PEERS = ROOT / ".cache" / "peers"
REQUIREMENTS = Path(__file__).parent / "peers" / "requirements.txt"
LIMIT_S, ROW_S = 290.0, 100.0
"""Seconds after which the suite starts no row, and those that a row may take."""
COLUMNS = ("peer", "task", "device", "lanes", "lane_steps_per_s", "start_s", "compile_s", "reason", "note")


@dataclasses.dataclass(frozen=True)
class Options:
    """What to measure."""

    peer_python: str = str(PEERS / "bin" / "python")
    """The interpreter that has the peers."""
    install_peers: bool = False
    """Build the peers' environment and end."""
    name: str | None = None
    """The result's name, by default the machine's: cpu2_peers, h200_peers."""
    only: tuple[str, ...] = ()
    """Measure the rows of these peers only."""
    note: str = ""
    """A remark stored with the result, such as other load on the machine."""


def install(folder: Path) -> None:
    """Build the peers' environment in `folder`; on a machine with a GPU, jax gets its CUDA wheels."""
    subprocess.run([sys.executable, "-m", "venv", folder], check=True)
    cuda = ["jax[cuda13]"] if jax.default_backend() == "gpu" else []
    subprocess.run([folder / "bin" / "python", "-m", "pip", "install", "-r", REQUIREMENTS, *cuda], check=True)


def measure(job: Job, python: str, seconds: float) -> dict[str, Any]:
    """Return the row of `job`, run within `seconds`, or one with the `reason` for which it did not run."""
    blank = {"peer": job.peer, "task": job.task, "lanes": job.lanes}
    blank |= dict.fromkeys(("device", "lane_steps_per_s", "start_s", "compile_s"))
    if seconds < 1:
        return {**blank, "reason": "not run: the suite's time was over"}
    if shutil.which(python) is None:
        build = "python -m benchmarks.speed.suite --install-peers"
        return {**blank, "reason": f"no interpreter {python}; build one with: {build}"}
    try:
        return start(job, python, seconds)
    except (RuntimeError, subprocess.TimeoutExpired, OSError) as error:
        return {**blank, "reason": str(error)[-300:]}


def start(job: Job, python: str, seconds: float) -> dict[str, Any]:
    """Return what the process of `job` printed.

    Raises:
        RuntimeError: it failed; the message is its last line on stderr.
        subprocess.TimeoutExpired: it took longer than `seconds`.
    """
    paths = [str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
    done = subprocess.run(
        [python, *job.arguments], capture_output=True, text=True, env=environment, cwd=ROOT, timeout=seconds
    )
    lines, errors = done.stdout.strip().splitlines(), done.stderr.strip().splitlines()
    if done.returncode or not lines:
        raise RuntimeError(errors[-1] if errors else f"ended with code {done.returncode}")
    return json.loads(lines[-1])


def machine() -> str:
    """Return the name of this machine's results: `cpu2` for two cores, `h200` for that GPU."""
    if jax.default_backend() == "cpu":
        return f"cpu{len(own_cores())}"
    kind = jax.devices()[0].device_kind
    model = re.search(r"\b[A-Z]+\d+", kind)
    return (model.group() if model else kind.replace(" ", "-")).lower()


def save_rows(rows: list[dict[str, Any]], path: Path, options: Options) -> None:
    """Write the rows so far, and the ratios between them, as json and csv."""
    save(path, {"cores": len(own_cores()), "note": options.note, "ratios": ratios(rows), "rows": rows})
    flat = [{name: row.get(name) for name in COLUMNS} for row in rows]
    for row, source in zip(flat, rows, strict=True):
        row["versions"] = " ".join(f"{name}={value}" for name, value in source.get("versions", {}).items())
    path.with_suffix(".csv").write_text(csv_text(flat))


def format_row(row: dict[str, Any]) -> str:
    """Return one line about `row`."""
    label = f"{row['peer']:24} {row['task']:22} {row['lanes']:3} lanes"
    if row.get("reason"):
        return f"{label}  {row['reason']}"
    times = f"start {row['start_s']:5.1f} s, compile {row['compile_s']:5.1f} s"
    return f"{label} {row['lane_steps_per_s']:10,.1f} lane-steps/s, {times}"


def main(options: Options) -> None:
    """Measure the rows of the suite, each in its own process."""
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
    if options.install_peers:
        install(PEERS)
        return
    path = RESULTS / "speed" / f"{options.name or f'{machine()}_peers'}.json"
    until = time.monotonic() + LIMIT_S
    rows: list[dict[str, Any]] = []
    device = "cpu" if jax.default_backend() == "cpu" else "gpu"
    for job in plan(device):
        if options.only and job.peer not in options.only:
            continue
        python = sys.executable if job.ours else options.peer_python
        rows.append(measure(job, python, min(ROW_S, until - time.monotonic())))
        print(format_row(rows[-1]), flush=True)
        save_rows(rows, path, options)
    for ratio in ratios(rows):
        print(ratio["says"], flush=True)


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
