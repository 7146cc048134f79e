"""The launcher of sweeps: it plans a grid, starts workers and reports every run, without importing jax."""

import json
import os
import subprocess
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from earl_jax.errors import InputError
from earl_jax.options import TimeLimit
from earl_jax.sweeps import processes
from earl_jax.sweeps import slurm as slurm_arrays
from earl_jax.sweeps.processes import Task, Workers, concurrent_events, worker_events
from earl_jax.sweeps.slots import PerDevice, require_valid, worker_slots

LAUNCHERS = ("local", "slurm")
EmitLine = Callable[[str], None]


class Outcome(NamedTuple):
    """The number of `failed` runs of a sweep, and the names of the runs that its time limit left `unfinished`."""

    failed: int
    unfinished: tuple[str, ...] = ()


def sweep(
    grid: Path,
    out: Path,
    launcher: str = "local",
    *,
    max_lanes: int | None = None,
    slurm: tuple[str, ...] = (),
    devices: int | None = None,
    per_device: PerDevice = None,
    emit: EmitLine = print,
    logs: Sequence[str] = (),
    minutes: float | TimeLimit | None = None,
) -> Outcome:
    """Return the outcome of a grid, after training its unfinished runs (local) or submitting them (slurm).

    Args:
        grid: a TOML file (docs/sweeps.md).
        out: the parent folder of the run folders; the same call continues unfinished runs there.
        launcher: `local`, on this machine, or `slurm`, an array job with a task per program group.
        max_lanes: the largest number of lanes in a program group.
        slurm: name=value pairs for sbatch, including `time` (minutes).
        devices: the number of devices that share the lanes of a program group.
        per_device: the number of program groups that train on each GPU of this machine at a time, or on a machine without
            one; `auto` for the measured number. By default one group trains after another, on one GPU.
        emit: receives a line for each change of a run's state, and a summary.
        logs: loggers that new runs use besides metrics.csv: `tensorboard`, `wandb`.
        minutes: a limit of wall-clock time of the whole sweep, from this call on (local only). Runs in progress end after
            the chunk of steps in which it runs out, with a checkpoint; groups that have not started are left.

    Raises:
        ValueError: the grid, the folder or an option is invalid; nothing has started.
    """
    limit = TimeLimit.of(minutes)
    if launcher not in LAUNCHERS:
        raise InputError(f"unknown launcher {launcher!r}; choose from {', '.join(LAUNCHERS)}")
    if slurm and launcher != "slurm":
        raise InputError("--slurm options go with --launcher slurm")
    if limit and launcher == "slurm":
        raise InputError("--minutes goes with --launcher local; with slurm, --slurm time=MINUTES limits each job")
    require_valid(per_device, launcher, devices)
    executor = slurm_arrays.make_executor(out, slurm) if launcher == "slurm" else None
    plan = plan_sweep(grid, out, max_lanes)
    unfinished = {name for group in plan["groups"] for name in group["runs"]}
    for name in plan["runs"]:
        if name not in unfinished:
            emit(f"done       {name}  (before)")
    common = {"out": plan["out"], "devices": devices, "logs": list(logs), "limit": limit}
    tasks = [
        {**common, "runs": {name: plan["runs"][name]["config"] for name in group["runs"]}} for group in plan["groups"]
    ]
    if executor is not None:
        slurm_arrays.submit(plan, tasks, executor, emit)
        return Outcome(failed=0)
    return _run_locally({**plan, "per_device": per_device, "limit": limit}, tasks, emit)


def plan_sweep(grid: Path, out: Path, max_lanes: int | None = None) -> dict[str, Any]:
    """Return the runs of a grid with their steps so far, and the program groups of unfinished runs, from a worker.

    Keys: `out`, the folder; `runs`, the `step` and `config` of each run by name; `groups`, each with the names of its `runs`,
    its `lanes`, `step`, `steps` and `replay_bytes`.

    Raises:
        ValueError: as `sweep`.
    """
    if max_lanes is not None and max_lanes < 1:
        raise InputError(f"max_lanes must be at least 1, not {max_lanes}")
    lanes = [] if max_lanes is None else ["--max-lanes", str(max_lanes)]
    command = [*processes.WORKER, "plan", str(grid), "--out", str(out.resolve()), *lanes, processes.TIED]
    reading, writing = os.pipe()
    with os.fdopen(reading), os.fdopen(writing, "w"):
        environment = {**os.environ, "JAX_PLATFORMS": "cpu"}
        planner = subprocess.run(command, stdin=reading, capture_output=True, text=True, env=environment)
    if planner.returncode:
        message = planner.stderr.strip() or f"the planner ended with code {planner.returncode}"
        raise InputError(message.splitlines()[-1])
    return json.loads(planner.stdout.splitlines()[-1])


def describe(plan: dict[str, Any]) -> str:
    """Return a plan as text: the lanes, replay and folders of each program, and a summary."""
    lines = []
    for number, group in enumerate(plan["groups"], 1):
        replay = f"replay {group['replay_bytes'] / 1e6:,.1f} MB"
        lines.append(f"program {number}: {group['lanes']} lanes, steps {group['step']} to {group['steps']}, {replay}")
        lines += [f"  {plan['out']}/{name}" for name in group["runs"]]
    finished = len(plan["runs"]) - sum(len(group["runs"]) for group in plan["groups"])
    summary = f"{len(plan['runs'])} runs, {finished} of them done; programs to run: {len(plan['groups'])}"
    return "\n".join([*lines, summary])


def _run_locally(plan: dict[str, Any], tasks: list[Task], emit: EmitLine) -> Outcome:
    """Train the program groups of `plan`, as many at a time as there are slots, and return the outcome."""
    last_states: dict[str, str] = {}
    with worker_slots(plan, emit) as slots, Workers() as workers:
        tasks = [{**task, "progress": len(slots) == 1} for task in tasks]
        for event in concurrent_events(tasks, slots, workers, worker_events):
            state = "stopped" if workers.signal and event["state"] == "failed" else event["state"]
            last_states[event["run"]] = state
            emit(f"{state:<10} {event['run']}{_details(event)}")
    if workers.signal:
        emit("stopped; repeat the command to continue")
        raise SystemExit(128 + workers.signal)
    return _summarise(plan, last_states, emit)


def _details(event: dict[str, Any]) -> str:
    """Return what a line says about `event` after the name of its run: the step, or the cause of a failure."""
    if event.get("step"):
        return f"  {'at' if event['state'] == 'stopped' else 'from'} step {event['step']}"
    return f"  {event.get('why', '')}".rstrip()


def _summarise(plan: dict[str, Any], last_states: dict[str, str], emit: EmitLine) -> Outcome:
    """Return the outcome of the runs of `plan` with their `last_states`, and emit it as one line."""
    count, names = Counter(last_states.values()), [name for group in plan["groups"] for name in group["runs"]]
    unfinished = tuple(name for name in names if last_states.get(name) not in ("done", "failed"))
    before = len(plan["runs"]) - len(names)
    line = f"{len(plan['runs'])} runs: {before} done before, {count['done']} done now, {count['failed']} failed"
    if unfinished:
        line += f", {len(unfinished)} unfinished after {plan['limit']}; repeat the command to continue"
    emit(line)
    return Outcome(count["failed"], unfinished)
