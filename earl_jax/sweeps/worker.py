"""The worker of a sweep: it trains program groups and reports the state of each run. `sweeps/__main__.py` is its process."""

import contextlib
import gc
import json
import os
import signal
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from earl_jax.errors import InputError, is_input_error
from earl_jax.options import TimeLimit
from earl_jax.runs.checkpoint import newest
from earl_jax.runs.config import RunConfig
from earl_jax.runs.contents import has_results
from earl_jax.runs.files import inside
from earl_jax.runs.folder import RunFolder
from earl_jax.runs.logging import check_logs
from earl_jax.sweeps.planner import PlannedRun, open_folder, plan, program_groups
from earl_jax.training.runner import Run, plan_runs, run_program

SCHEDULER_SIGNALS = (signal.SIGTERM, signal.SIGUSR1, signal.SIGUSR2)
Emit = Callable[..., None]
"""Receives an event as `emit(name, state, **details)`; the states are started, resumed, done, stopped and failed."""


@contextlib.contextmanager
def claimed(path: Path, run: Run, logs: Sequence[str] = ()) -> Iterator[RunFolder]:
    """Lock the folder of `run` at `path` for this process, after creating it if necessary.

    Raises:
        ValueError: the folder holds anything else, or another process uses it.
        OSError: the folder cannot be written to.
    """
    if not has_results(path):
        RunFolder.create(path, run.config, run.env.resolved_engine, logs)
    folder = open_folder(path, run.config)
    check_logs(folder.logs)
    with folder.claimed():
        yield folder


def parse_config(fields: dict[str, Any]) -> RunConfig:
    """Return the config with the JSON values `fields`."""
    return RunConfig(**{**fields, "seeds": tuple(fields["seeds"])})


def work(
    out: Path,
    configs: dict[str, RunConfig],
    emit: Emit,
    progress: bool = True,
    devices: int | None = None,
    logs: Sequence[str] = (),
    limit: TimeLimit | None = None,
) -> bool:
    """Train the runs `configs`, by name in the sweep at `out`, and return whether none of them has failed.

    The runs are grouped again by the steps of their newest checkpoints. `emit` receives every event. Runs end early, as
    `stopped`, when the `limit` passes; groups that have not started by then are left.
    """
    planned: list[PlannedRun] = []
    succeeded = True
    with contextlib.ExitStack() as stack:
        for name, config in configs.items():
            try:
                run = Run.resolve(config)
                run.folder = stack.enter_context(claimed(inside(out, name), run, logs))
                planned.append(PlannedRun(name=name, run=run, step=newest(run.folder.checkpoints)))
            except Exception as error:  # the other runs may still succeed
                succeeded = False
                emit(name, "failed", why=_cause(error))
        for entry in planned:
            if entry.finished:
                emit(entry.name, "done")
        for group in program_groups(planned):
            if not (limit and limit.passed):
                succeeded &= _train_group(group, emit, progress, devices, limit)
                continue
            for entry in group:
                emit(entry.name, "stopped", step=entry.step)
    return succeeded


def _train_group(
    group: list[PlannedRun], emit: Emit, progress: bool, devices: int | None, limit: TimeLimit | None
) -> bool:
    """Train all runs of `group` in one program and return whether it succeeded."""
    for entry in group:
        emit(entry.name, "resumed" if entry.step else "started", step=entry.step)
    try:
        runs = [entry.run for entry in group]
        step = int(run_program(plan_runs(runs, devices), runs, progress, limit).step)
    except Exception as error:  # the next group may still succeed
        cause = _cause(error)
        for entry in group:
            emit(entry.name, "failed", why=cause)
        return False
    for entry in group:
        if step < entry.run.config.steps:
            emit(entry.name, "stopped", step=step)
        else:
            emit(entry.name, "done")
    return True


def _cause(error: Exception) -> str:
    """Return `error` as one line, after printing its traceback if it is more than invalid input."""
    if isinstance(error, InputError):
        return str(error)
    if not is_input_error(error):
        traceback.print_exception(error)
    return f"{type(error).__name__}: {error}".splitlines()[0]


def serve(task: str) -> int:
    """Train the runs of `task`, a JSON object, and return the exit code: 1 if one of them is not finished."""
    gc.set_threshold(100_000, 50, 50)  # as on the command line
    fields = json.loads(task)
    configs = {name: parse_config(config) for name, config in fields["runs"].items()}
    if "SLURM_JOB_ID" in os.environ:  # submitit handles these signals and resubmits the job before this process ends
        for number in SCHEDULER_SIGNALS:
            signal.signal(number, signal.SIG_IGN)

    def emit(name: str, state: str, **details: Any) -> None:
        print(json.dumps({"run": name, "state": state, **details}), flush=True)

    succeeded = work(
        Path(fields["out"]),
        configs,
        emit,
        progress=fields.get("progress", True),
        devices=fields.get("devices"),
        logs=fields.get("logs", ()),
        limit=TimeLimit(*fields["limit"]) if fields.get("limit") else None,
    )
    return 0 if succeeded else 1


def print_plan(grid: Path, out: Path, max_lanes: int | None) -> int:
    """Print the plan of a grid as JSON and return the exit code: 2 with a one-line error for invalid input."""
    try:
        print(json.dumps(plan(grid, out, max_lanes)))
    except Exception as error:
        if not is_input_error(error):
            raise
        print(error, file=sys.stderr)
        return 2
    return 0
