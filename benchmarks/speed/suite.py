"""Compare the speed of earl_jax with other ways to train seeds, in one run on one machine:

    python -m benchmarks.speed.suite --install-peers            # once: .cache/peers, from benchmarks/speed/peers/requirements.txt
    python -m benchmarks.speed.suite --suite quick              # under 5 minutes on 2 cores
    python -m benchmarks.speed.suite --suite full               # under 8 minutes on a GPU machine with 16 cores

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
import tempfile
import time
from pathlib import Path
from typing import Any, Literal

import jax
import tyro

from benchmarks.output import RESULTS, ROOT, save
from benchmarks.speed.peers.plan import LIMIT_S, Job, plan, ratios
from earl_jax.options.environment import own_cores
from earl_jax.report.tables import csv_text

PEERS = ROOT / ".cache" / "peers"
REQUIREMENTS = Path(__file__).parent / "peers" / "requirements.txt"
COLUMNS = ("peer", "task", "device", "processes", "lanes", "lane_steps_per_s", "start_s", "compile_s", "reason", "note")


@dataclasses.dataclass(frozen=True)
class Options:
    """What to measure."""

    suite: Literal["quick", "full"] = "quick"
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
    """Return the row of `job`, run within `seconds`; rates of parallel processes are added, their other times averaged."""
    blank = {"peer": job.peer, "task": job.task, "device": job.device, "processes": job.processes, "lanes": job.lanes}
    blank |= dict.fromkeys(("lane_steps_per_s", "start_s", "compile_s"))
    if seconds < 1:
        return {**blank, "reason": "not run: the suite's time was over"}
    if shutil.which(python) is None:
        return {
            **blank,
            "reason": f"no interpreter {python}; build one with: python -m benchmarks.speed.suite --install-peers",
        }
    try:
        rows = start(job, python, seconds)
    except (RuntimeError, subprocess.TimeoutExpired, OSError) as error:
        return {**blank, "reason": str(error)[-300:]}
    first = rows[0]
    means = {name: round(sum(row[name] for row in rows) / len(rows), 2) for name in ("start_s", "compile_s")}
    total = round(sum(row["lane_steps_per_s"] for row in rows), 1)
    return {**first, **means, "processes": len(rows), "lane_steps_per_s": total}


def start(job: Job, python: str, seconds: float) -> list[dict[str, Any]]:
    """Return what each process of `job` printed.

    Raises:
        RuntimeError: one of them failed; the message is its last line on stderr.
        subprocess.TimeoutExpired: they took longer than `seconds`.
    """
    paths = [str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths), **job.environment}
    until = time.monotonic() + seconds
    with tempfile.TemporaryDirectory() as barrier:
        commands = [
            [python, *job.arguments, *job.barrier_arguments(number, barrier)] for number in range(job.processes)
        ]
        running = [
            subprocess.Popen(
                command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment, cwd=ROOT
            )
            for command in commands
        ]
        try:
            return [read_row(process, until - time.monotonic()) for process in running]
        finally:
            for process in running:
                process.kill()
                process.wait()


def read_row(process: subprocess.Popen, seconds: float) -> dict[str, Any]:
    """Return the row that `process` prints as its last line."""
    out, err = process.communicate(timeout=max(seconds, 0.1))
    lines, errors = out.strip().splitlines(), err.strip().splitlines()
    if process.returncode or not lines:
        raise RuntimeError(errors[-1] if errors else f"ended with code {process.returncode}")
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
    save(
        path,
        {"suite": options.suite, "cores": len(own_cores()), "note": options.note, "ratios": ratios(rows), "rows": rows},
    )
    flat = [{name: row.get(name) for name in COLUMNS} for row in rows]
    for row, source in zip(flat, rows, strict=True):
        row["versions"] = " ".join(f"{name}={value}" for name, value in source.get("versions", {}).items())
    path.with_suffix(".csv").write_text(csv_text(flat))


def format_row(row: dict[str, Any]) -> str:
    """Return one line about `row`."""
    label = f"{row['peer']:24} {row['task']:22} {row['device']:12} {row['processes']:3} x {row['lanes']:3} lanes"
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
    until = time.monotonic() + LIMIT_S[options.suite]
    rows: list[dict[str, Any]] = []
    device = "cpu" if jax.default_backend() == "cpu" else "gpu"
    for job in plan(options.suite, device, len(own_cores())):
        if options.only and job.peer not in options.only:
            continue
        python = sys.executable if job.ours else options.peer_python
        rows.append(measure(job, python, min(job.limit_s, until - time.monotonic())))
        print(format_row(rows[-1]), flush=True)
        save_rows(rows, path, options)
    for ratio in ratios(rows):
        print(ratio["says"], flush=True)


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
