"""The launcher of sweeps: it plans, starts workers and tells what became of each cell, and never imports jax."""

import contextlib
import json
import os
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

WORKER = [sys.executable, "-m", "earl_jax.sweeps.worker"]
LOGS = "slurm"
"""The folder in a sweep's that submitit keeps its scripts and logs in."""
RETRIES = 100
"""How often a job that ran out of time is put back in the queue."""
Say = Callable[[str], None]


def sweep(
    grid: Path,
    out: Path,
    launcher: str = "local",
    max_lanes: int | None = None,
    slurm: tuple[str, ...] = (),
    devices: int | None = None,
    say: Say = print,
    logs: Sequence[str] = (),
) -> int:
    """Return how many cells of a grid failed, after running those that are not finished (local) or submitting them (slurm).

    Args:
        grid: a TOML file, docs/sweeps.md.
        out: the folder of the run folders; the same call goes on with what is there.
        launcher: `local`, one pack after another on this machine, or `slurm`, an array job with a task for each pack.
        max_lanes: lanes of the largest pack.
        slurm: name=value pairs for sbatch, `time` (minutes) among them.
        devices: how many devices share the lanes of a pack.
        say: told a line for each cell, and a summary.
        logs: where the metrics of new runs go besides metrics.csv: `tensorboard`, `wandb`.

    Raises:
        ValueError: the grid, the folder or an option is wrong; nothing has been started then.
    """
    parameters = _parameters(slurm)
    if launcher not in LAUNCHERS:
        raise ValueError(f"unknown launcher {launcher!r}; choose from {', '.join(LAUNCHERS)}")
    if parameters and launcher != "slurm":
        raise ValueError("--slurm options go with --launcher slurm")
    executor = _executor(out, parameters) if launcher == "slurm" else None
    plan = planned(grid, out, max_lanes)
    waiting = {name for pack in plan["groups"] for name in pack["cells"]}
    for name in plan["cells"]:
        if name not in waiting:
            say(f"done       {name}  (before)")
    return LAUNCHERS[launcher]({**plan, "devices": devices, "logs": list(logs)}, say, executor)


def planned(grid: Path, out: Path, max_lanes: int | None = None) -> dict[str, Any]:
    """Return the cells of a grid with what they have reached, and the packs of unfinished ones, as a worker sees them.

    Raises:
        ValueError: as `sweep`.
    """
    if max_lanes is not None and max_lanes < 1:
        raise ValueError(f"max_lanes must be at least 1, not {max_lanes}")
    more = [] if max_lanes is None else ["--max-lanes", str(max_lanes)]
    command = [*WORKER, "plan", str(grid), "--out", str(out.resolve()), *more]
    found = subprocess.run(command, capture_output=True, text=True, env={**os.environ, "JAX_PLATFORMS": "cpu"})
    if found.returncode:
        told = found.stderr.strip() or f"planning ended with code {found.returncode}"
        raise ValueError(told.splitlines()[-1])
    return json.loads(found.stdout.splitlines()[-1])


def described(plan: dict[str, Any]) -> str:
    """Return a plan in words: every pack with its lanes, replay and folders, and what is finished."""
    lines = []
    for number, pack in enumerate(plan["groups"], 1):
        size = f"{pack['lanes']} lanes, steps {pack['step']} to {pack['steps']}, replay {pack['replay_bytes'] / 1e6:,.1f} MB"
        lines += [f"pack {number}: {size}", *(f"  {plan['out']}/{name}" for name in pack["cells"])]
    waiting = sum(len(pack["cells"]) for pack in plan["groups"])
    summary = f"{len(plan['cells'])} cells, {len(plan['cells']) - waiting} of them done; {len(plan['packs'])} programs"
    return "\n".join([*lines, summary])


class Work:
    """The work of one pack, to be called here or on another machine; one that ran out of time is asked to go on."""

    def __call__(self, task: dict[str, Any]) -> None:
        """Live `task` to its end; a cell that failed is a RuntimeError that says why."""
        failed = []
        for event in events(task):
            print(json.dumps(event), flush=True)
            if event["state"] == "failed":
                failed.append(f"{event['cell']}: {event['why']}")
        if failed:
            raise RuntimeError("; ".join(failed))

    def checkpoint(self, task: dict[str, Any]) -> Any:
        """Return what submitit is to submit when time is up or the job is preempted: the same again, from its checkpoints."""
        from submitit.helpers import DelayedSubmission

        return DelayedSubmission(self, task)


def events(task: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield what becomes of the cells of `task` as a worker lives them; one that it doesn't finish has failed.

    The worker ends when this process does, however it ends.
    """
    worker = subprocess.Popen([*WORKER, "work"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert worker.stdin is not None
    assert worker.stdout is not None
    open_cells = set(task["cells"])
    with worker:
        with contextlib.suppress(BrokenPipeError):  # a worker that is gone already has no events
            os.write(worker.stdin.fileno(), (json.dumps(task) + "\n").encode())
        for line in worker.stdout:
            event = _event(line)
            if event is None:
                print(line, end="", file=sys.stderr)
                continue
            if event["state"] in ("done", "failed"):
                open_cells.discard(event["cell"])
            yield event
    code = worker.returncode
    why = f"the worker was ended by signal {-code}" if code < 0 else f"the worker ended with code {code}"
    for name in sorted(open_cells):
        yield {"cell": name, "state": "failed", "why": why}


def _event(line: str) -> dict[str, Any] | None:
    try:
        event = json.loads(line)
    except json.JSONDecodeError:
        return None
    return event if isinstance(event, dict) and "cell" in event else None


def tasks(plan: dict[str, Any]) -> list[dict[str, Any]]:
    """Return what a worker needs to know of each pack, independent of the grid's file."""
    return [
        {
            "out": plan["out"],
            "devices": plan.get("devices"),
            "logs": plan.get("logs", []),
            "cells": {name: plan["cells"][name]["config"] for name in pack["cells"]},
        }
        for pack in plan["groups"]
    ]


def _local(plan: dict[str, Any], say: Say, executor: None) -> int:
    last: dict[str, str] = {}
    for task in tasks(plan):
        for event in events(task):
            last[event["cell"]] = event["state"]
            more = f"  from step {event['step']}" if event.get("step") else f"  {event.get('why', '')}".rstrip()
            say(f"{event['state']:<10} {event['cell']}{more}")
    count = Counter(last.values())
    before = len(plan["cells"]) - len(last)
    say(f"{len(plan['cells'])} cells: {before} done before, {count['done']} done now, {count['failed']} failed")
    return count["failed"]


def _slurm(plan: dict[str, Any], say: Say, executor: Any) -> int:
    jobs = executor.map_array(Work(), tasks(plan)) if plan["groups"] else []
    for job, pack in zip(jobs, plan["groups"], strict=True):
        for name in pack["cells"]:
            say(f"submitted  {name}  job {job.job_id}")
    say(f"{len(jobs)} jobs; logs in {Path(plan['out']) / LOGS}; the same command goes on with what they leave")
    return 0


LAUNCHERS: dict[str, Callable[..., int]] = {"local": _local, "slurm": _slurm}


def _executor(out: Path, parameters: dict[str, Any]) -> Any:
    """Return submitit's executor with `parameters` of sbatch."""
    try:
        import submitit
    except ImportError:
        raise ValueError("--launcher slurm needs submitit: pip install 'earl-jax[slurm]'") from None
    if "time" not in parameters:
        raise ValueError(
            "--launcher slurm needs a time limit in minutes: --slurm time=600 partition=... gpus_per_node=1"
        )
    try:
        executor = submitit.SlurmExecutor(out.resolve() / LOGS, max_num_timeout=RETRIES)
        executor.update_parameters(**{"job_name": "earl-jax", **parameters})
    except RuntimeError as error:
        raise ValueError(f"{error}; --launcher slurm runs where sbatch does") from None
    except ValueError as error:
        raise ValueError(" ".join(str(error).split())) from None
    return executor


def _parameters(pairs: tuple[str, ...]) -> dict[str, Any]:
    """Return name=value pairs as a dictionary, numbers as numbers."""
    found: dict[str, Any] = {}
    for pair in pairs:
        name, equals, text = pair.partition("=")
        if not equals or not name:
            raise ValueError(f"--slurm takes name=value, not {pair!r}")
        found[name] = int(text) if text.lstrip("-").isdigit() else text
    return found
