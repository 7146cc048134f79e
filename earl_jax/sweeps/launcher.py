"""The launcher of sweeps: it plans a grid, starts workers and reports every run, without importing jax."""

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from earl_jax.errors import InputError, require_known
from earl_jax.options import imports
from earl_jax.options.values import COUNT, TimeLimit, counted, require
from earl_jax.sweeps import slurm as slurm_arrays
from earl_jax.sweeps.processes import Event, Task, Workers, events, start
from earl_jax.sweeps.slots import MOST, PerDevice, Slot, open_slots

LAUNCHERS = ("local", "slurm")


class Outcome(NamedTuple):
    """The `state` of each run of a sweep by its name, with a `detail`: a step, or why the run failed."""

    runs: Mapping[str, Mapping[str, str]]

    @property
    def failed(self) -> tuple[str, ...]:
        """The names of the runs that failed."""
        return tuple(name for name, run in self.runs.items() if run["state"] == "failed")

    @property
    def unfinished(self) -> tuple[str, ...]:
        """The names of the runs that a time limit or a signal left unfinished."""
        return tuple(name for name, run in self.runs.items() if run["state"] not in ("done", "failed"))


class Stopped(SystemExit):
    """The signal `number` stopped a sweep; `outcome` is the outcome so far."""

    def __init__(self, number: int, outcome: Outcome):
        super().__init__(128 + number)
        self.outcome = outcome


def sweep(
    grid: Path,
    out: Path,
    launcher: str = "local",
    *,
    max_lanes: int | None = None,
    slurm: tuple[str, ...] = (),
    devices: int | None = None,
    per_device: PerDevice = None,
    emit: Callable[[str], None] = print,
    logs: Sequence[str] = (),
    minutes: float | TimeLimit | None = None,
) -> Outcome:
    """Train the unfinished runs of a grid (local) or submit them (slurm), and return the outcome.

    Args:
        grid: a TOML file (docs/sweeps.md).
        out: the parent folder of the run folders; the same call continues unfinished runs there.
        launcher: `local`, on this machine, or `slurm`, an array job with a task per program group.
        max_lanes: the largest number of lanes in a program group.
        slurm: options of sbatch, name=value, such as `time` (minutes).
        devices: the number of devices that share the lanes of a program group.
        per_device: the number of program groups that train at a time on each GPU of this machine, or on its CPU if it
            has no GPU; `auto` for the measured number. By default one group trains after another, on one GPU.
        emit: receives a line for each change of a run's state, and a summary.
        logs: loggers that new runs use besides metrics.csv: `tensorboard`, `wandb`.
        minutes: a limit of wall-clock time for the whole sweep, from this call on (local only). When it is reached,
            runs in progress end after their current chunk of steps, with a checkpoint; other groups do not start.

    Raises:
        ValueError: the grid, the folder or an option is invalid; nothing has started.
        Stopped: SIGINT, SIGTERM or SIGHUP arrived (local only); the runs in progress have saved a checkpoint.
    """
    limit = TimeLimit.of(minutes)
    options = check_options(launcher, slurm, devices, per_device, limit)
    plan = plan_sweep(grid, out, max_lanes, logs)
    for name in plan["finished"]:
        emit(f"done       {name}  (before)")
    common = {"out": plan["out"], "imports": plan["imports"], "devices": devices, "logs": list(logs), "limit": limit}
    tasks = [{**common, "runs": group["runs"]} for group in plan["groups"]]
    if launcher == "slurm":
        slurm_arrays.submit(out, tasks, options, emit)
        return Outcome({})
    runs, stopped_by = _run_locally(tasks, per_device, emit)
    earlier = {name: {"state": "done", "detail": "before"} for name in plan["finished"]}
    outcome = Outcome(earlier | runs)
    if stopped_by:
        emit("stopped; repeat the command to continue")
        raise Stopped(stopped_by, outcome)
    failed, left = len(outcome.failed), len(outcome.unfinished)
    done = f"{len(earlier)} done before, {len(runs) - left - failed} done now, {failed} failed"
    rest = f", {left} unfinished after {limit}; repeat the command to continue" if left else ""
    emit(f"{counted(len(outcome.runs), 'run')}: {done}{rest}")
    return outcome


def check_options(
    launcher: str, slurm: tuple[str, ...], devices: int | None, per_device: PerDevice, limit: TimeLimit | None
) -> dict[str, str]:
    """Return the options of sbatch, after a check of the options of `sweep` against each other. Errors as `sweep`."""
    require_known("launcher", launcher, LAUNCHERS)
    is_count = per_device in (None, "auto") or (type(per_device) is int and 1 <= per_device <= MOST)
    if devices is not None:
        require("devices", devices, COUNT)
    for is_wrong, message in (
        (not is_count, f"per_device must be auto, or a number from 1 to {MOST}, not {per_device}"),
        (slurm and launcher == "local", "--slurm options go with --launcher slurm"),
        (limit and launcher == "slurm", "--minutes goes with --launcher local; --slurm time=MINUTES limits each job"),
        (
            per_device and launcher == "slurm",
            "--per-device goes with --launcher local, not slurm: a task of the array has one program group. "
            "To share the GPUs of a job, submit a job that calls earl-jax sweep --per-device",
        ),
        (
            per_device and devices is not None,
            "--per-device puts several programs on a GPU, and --devices spreads a program over several; choose one of them",
        ),
    ):
        if is_wrong:
            raise InputError(message)
    return slurm_arrays.options_of(slurm)


def plan_sweep(grid: Path, out: Path, max_lanes: int | None = None, logs: Sequence[str] = ()) -> dict[str, Any]:
    """Return the names of finished runs of a grid and the program groups of the others, from a worker on the CPU.

    Keys: `out`, the folder; `imports`, the files that workers run first; `finished`; `groups`, each with the configs of its
    `runs` by name, its `lanes`, the `step` from which they continue, their `steps` and `replay_bytes`.
    Errors as `sweep`.
    """
    if max_lanes is not None:
        require("max_lanes", max_lanes, COUNT)
    files = [{**record, "file": os.path.abspath(record["file"])} for record in imports.records()]
    path = Path(grid)
    if path.is_relative_to("/dev"):  # a worker's /dev/stdin is another file
        own = Path(f"/proc/{os.getpid()}/fd", path.name.replace("stdin", "0"))
        path = own if path.is_fifo() else path.resolve()
    task = {"grid": str(path), "out": str(out), "max_lanes": max_lanes, "logs": logs, "imports": files}
    with start(task, Slot(variables={"JAX_PLATFORMS": "cpu"})) as planner:
        reply: Event = next(events(planner), {"detail": "the planner ended without a plan; its error is above"})
    if "plan" not in reply:
        raise InputError(reply["detail"])
    return reply["plan"]


def describe(plan: dict[str, Any]) -> str:
    """Return a plan as text: the lanes, replay and folders of each program, and a summary."""
    lines = []
    for number, group in enumerate(plan["groups"], 1):
        replay = f"replay {group['replay_bytes'] / 1e6:,.1f} MB"
        lanes = counted(group["lanes"], "lane")
        lines.append(f"program {number}: {lanes}, steps {group['step']} to {group['steps']}, {replay}")
        lines += [f"  {plan['out']}/{name}" for name in group["runs"]]
    finished = len(plan["finished"])
    runs = counted(finished + sum(len(group["runs"]) for group in plan["groups"]), "run")
    return "\n".join([*lines, f"{runs}, {finished} of them done; programs to run: {len(plan['groups'])}"])


def _run_locally(
    tasks: list[Task], per_device: PerDevice, emit: Callable[[str], None]
) -> tuple[dict[str, dict[str, str]], int | None]:
    """Return the `Outcome.runs` of `tasks`, `waiting` if they did not start, and the signal that stopped them, if one did."""
    runs = {name: {"state": "waiting", "detail": ""} for task in tasks for name in task["runs"]}
    envs = [config["env"] for task in tasks for config in list(task["runs"].values())[:1]]
    with open_slots(per_device, envs, emit) as slots, Workers() as workers:
        tasks = [{**task, "progress": len(slots) == 1} for task in tasks]
        for event in workers.run_all(tasks, slots):
            state = "stopped" if workers.signal and event["state"] == "failed" else event["state"]
            runs[event["run"]] = {"state": state, "detail": event["detail"]}
            emit(f"{state:<10} {event['run']}  {event['detail']}".rstrip())
    return runs, workers.signal
