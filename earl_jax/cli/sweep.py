"""The command that trains a grid of runs: sweep."""

import itertools
from pathlib import Path
from typing import Literal

from earl_jax.cli.arguments import (
    JSON,
    Devices,
    Logs,
    Minutes,
    PerDevice,
    Positional,
    Slurm,
    emit,
    parse_minutes,
    print_line,
)


def sweep(
    grid: Positional[Path],
    out: Path = Path("runs/sweep"),
    launcher: Literal["local", "slurm"] = "local",
    max_lanes: int | None = None,
    slurm: Slurm = (),
    devices: Devices = None,
    per_device: PerDevice = None,
    minutes: Minutes = None,
    log: Logs = (),
    dry_run: bool = False,
    json: JSON = False,
) -> None:
    """Train every run of a grid; runs that fit one program share it. After a kill, repeat the command to continue.

    Args:
        grid: TOML file of tasks, methods and options (docs/sweeps.md).
        out: Parent folder of the run folders, OUT/<task>/<method>/<options>.
        launcher: local runs the programs on this machine; slurm submits an array job.
        max_lanes: Largest number of lanes (runs x seeds) in one program. By default there is no limit.
        dry_run: Print the programs with their lanes, folders and memory, and start nothing.
    """
    limit = parse_minutes(minutes)
    from earl_jax.sweeps import launcher as launchers

    if dry_run:
        plan = launchers.plan_sweep(grid, out, max_lanes)
        emit(plan, json, launchers.describe(plan))
        return
    lines: list[str] = []
    outcome = launchers.sweep(
        grid,
        out,
        launcher,
        max_lanes=max_lanes,
        slurm=tuple(itertools.chain(*slurm)),
        devices=devices,
        per_device=per_device,
        emit=lines.append if json else print_line,
        logs=tuple(itertools.chain(*log)),
        minutes=limit,
    )
    if json:
        values = {"out": str(out), "failed": outcome.failed, "lines": lines, "stopped": bool(outcome.unfinished)}
        if outcome.unfinished:
            values |= {"unfinished": outcome.unfinished, "resume": "repeat the command"}
        emit(values, json, "")
    if outcome.failed:
        raise SystemExit(1)
