"""The launcher of sweeps: it plans a grid, starts workers and reports every run, without importing jax."""

import contextlib
import json
import os
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from earl_jax.errors import InputError
from earl_jax.options import TimeLimit
from earl_jax.sweeps.per_device import ALONE, PerDevice, WorkerOptions, require_valid, worker_slots
from earl_jax.sweeps.pool import ForwardedSignal, concurrent_events, relayed_lines
from earl_jax.sweeps.slurm import LOGS, sbatch_parameters, slurm_executor

WORKER = [sys.executable, "-m", "earl_jax.sweeps"]
TIED = "--end-with-stdin"
"""The worker's option to end as soon as its launcher does: stdin is a pipe that the launcher holds open."""
ENDS = ("done", "failed", "stopped")
"""States in which a worker leaves a run; it is stopped by the time limit."""
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
    parameters = sbatch_parameters(slurm)
    if launcher not in LAUNCHERS:
        raise InputError(f"unknown launcher {launcher!r}; choose from {', '.join(LAUNCHERS)}")
    if parameters and launcher != "slurm":
        raise InputError("--slurm options go with --launcher slurm")
    if limit and launcher == "slurm":
        raise InputError("--minutes goes with --launcher local; with slurm, --slurm time=MINUTES limits each job")
    require_valid(per_device, launcher, devices)
    executor = slurm_executor(out, parameters) if launcher == "slurm" else None
    plan = plan_sweep(grid, out, max_lanes)
    unfinished = {name for group in plan["groups"] for name in group["runs"]}
    for name in plan["runs"]:
        if name not in unfinished:
            emit(f"done       {name}  (before)")
    plan |= {"devices": devices, "per_device": per_device, "logs": list(logs), "limit": limit}
    return LAUNCHERS[launcher](plan, emit, executor)


def plan_sweep(grid: Path, out: Path, max_lanes: int | None = None) -> dict[str, Any]:
    """Return the runs of a grid with their steps so far, and the program groups of unfinished runs, from a worker.

    Keys: `out`, the folder; `runs`, the `step` and `config` of each run by name; `groups`, each with the names of its `runs`,
    its `lanes`, `step`, `steps` and `replay_bytes`.

    Raises:
        ValueError: as `sweep`.
    """
    if max_lanes is not None and max_lanes < 1:
        raise InputError(f"max_lanes must be at least 1, not {max_lanes}")
    limit = [] if max_lanes is None else ["--max-lanes", str(max_lanes)]
    command = [*WORKER, "plan", str(grid), "--out", str(out.resolve()), *limit, TIED]
    environment = {**os.environ, "JAX_PLATFORMS": "cpu"}
    with _open_pipe() as stdin:
        planner = subprocess.run(command, stdin=stdin, capture_output=True, text=True, env=environment)
    if planner.returncode:
        message = planner.stderr.strip() or f"the planner ended with code {planner.returncode}"
        raise InputError(message.splitlines()[-1])
    return json.loads(planner.stdout.splitlines()[-1])


@contextlib.contextmanager
def _open_pipe() -> Iterator[int]:
    """Yield the end for reading of a pipe that stays open until the context or this process ends."""
    reading, writing = os.pipe()
    try:
        yield reading
    finally:
        os.close(reading)
        os.close(writing)


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


class GroupJob:
    """A callable that trains one program group, on this or another machine. After a time-out it is submitted again."""

    def __call__(self, task: dict[str, Any]) -> None:
        """Train all runs of `task`; failed runs are a RuntimeError that gives their causes."""
        failures = []
        for event in worker_events(task):
            print(json.dumps(event), flush=True)
            if event["state"] == "failed":
                failures.append(f"{event['run']}: {event['why']}")
        if failures:
            raise RuntimeError("; ".join(failures))

    def checkpoint(self, task: dict[str, Any]) -> Any:
        """Return the job that submitit submits after a time-out or a preemption: this one again, from its checkpoints."""
        from submitit.helpers import DelayedSubmission

        return DelayedSubmission(self, task)


def worker_events(
    task: dict[str, Any], stop: ForwardedSignal | None = None, options: WorkerOptions = ALONE
) -> Iterator[dict[str, Any]]:
    """Yield the events of a worker that trains the runs of `task`. A run that it does not finish ends with a failed event.

    The worker ends when this process ends, for whatever reason. It receives the signals of `stop`. If the time limit of the
    task has passed, there is no worker and no event.
    """
    if task.get("limit") and task["limit"].passed:
        return
    worker = subprocess.Popen(
        [*WORKER, "work", TIED, *options.arguments],
        env=options.environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE if options.neighbours else None,
        text=True,
        errors="replace",
        start_new_session=stop is not None,
    )
    if stop is not None:
        stop.pass_on_to(worker)
    assert worker.stdin is not None
    assert worker.stdout is not None
    unfinished, line = set(task["runs"]), json.dumps({**task, "progress": not options.neighbours}) + "\n"
    with worker, relayed_lines(worker.stderr):
        with contextlib.suppress(BrokenPipeError):  # a worker that has ended already sends no events
            os.write(worker.stdin.fileno(), line.encode())
        for line in worker.stdout:
            event = _parse_event(line)
            if event is None:
                sys.stderr.write(line)  # as a whole, because other workers write too
                continue
            if event["state"] in ENDS:
                unfinished.discard(event["run"])
            yield event
    code = worker.returncode
    why = f"the worker was ended by signal {-code}" if code < 0 else f"the worker ended with code {code}"
    for name in sorted(unfinished):
        yield {"run": name, "state": "failed", "why": why}


def _parse_event(line: str) -> dict[str, Any] | None:
    """Return the event in a line of a worker's output, or None for any other line."""
    try:
        event = json.loads(line)
    except json.JSONDecodeError:
        return None
    return event if isinstance(event, dict) and "run" in event else None


def worker_tasks(plan: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the input of a worker for each program group; it does not depend on the file of the grid."""
    return [
        {
            "out": plan["out"],
            "devices": plan.get("devices"),
            "logs": plan.get("logs", []),
            "limit": plan.get("limit"),
            "runs": {name: plan["runs"][name]["config"] for name in group["runs"]},
        }
        for group in plan["groups"]
    ]


def _run_locally(plan: dict[str, Any], emit: EmitLine, executor: None) -> Outcome:
    """Train the program groups of `plan`, as many at a time as there are slots, and return the outcome."""
    last_states: dict[str, str] = {}
    with ForwardedSignal() as stop, worker_slots(plan, emit) as slots, stop.ending_workers():
        for event in concurrent_events(worker_tasks(plan), slots, stop, worker_events):
            state = "stopped" if stop.signal and event["state"] == "failed" else event["state"]
            last_states[event["run"]] = state
            emit(f"{state:<10} {event['run']}{_details(event)}")
    if stop.signal:
        emit("stopped; repeat the command to continue")
        raise SystemExit(128 + stop.signal)
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


def _submit_to_slurm(plan: dict[str, Any], emit: EmitLine, executor: Any) -> Outcome:
    """Submit an array job with one task for each program group of `plan`, and return that none has failed."""
    jobs = executor.map_array(GroupJob(), worker_tasks(plan)) if plan["groups"] else []
    for job, group in zip(jobs, plan["groups"], strict=True):
        for name in group["runs"]:
            emit(f"submitted  {name}  job {job.job_id}")
    emit(f"{len(jobs)} jobs; logs in {Path(plan['out']) / LOGS}; repeat the command later to submit unfinished runs")
    return Outcome(failed=0)


LAUNCHERS: dict[str, Callable[..., Outcome]] = {"local": _run_locally, "slurm": _submit_to_slurm}
