"""The SLURM launcher of sweeps, through submitit: an array job with a task for each program group."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from earl_jax.errors import InputError
from earl_jax.sweeps.processes import Task, Workers

LOGS = "slurm"
"""Name of the folder, in that of the sweep, for submitit's scripts and logs."""
RETRIES = 100
"""How often a job that reaches its time limit returns to the queue."""


class GroupJob:
    """A callable that trains one program group, on this or another machine. After a time-out it is submitted again."""

    def __call__(self, task: Task) -> None:
        """Train all runs of `task`; failed runs are a RuntimeError that gives their causes."""
        failures = []
        for event in Workers().run({**task, "ignore_signals": True}):
            print(json.dumps(event), flush=True)
            if event["state"] == "failed":
                failures.append(f"{event['run']}: {event['detail']}")
        if failures:
            raise RuntimeError("; ".join(failures))

    def checkpoint(self, task: Task) -> Any:
        """Return the job that submitit submits after a time-out or a preemption: this one again, from its checkpoints."""
        from submitit.helpers import DelayedSubmission

        return DelayedSubmission(self, task)


def submit(tasks: list[Task], executor: Any, emit: Callable[[str], None]) -> None:
    """Submit `tasks`, one for each program group, as an array job of `executor`."""
    jobs = executor.map_array(GroupJob(), tasks) if tasks else []
    for job, task in zip(jobs, tasks, strict=True):
        for name in task["runs"]:
            emit(f"submitted  {name}  job {job.job_id}")
    emit(f"{len(jobs)} jobs; logs in {executor.folder}; repeat the command later to submit unfinished runs")


def make_executor(out: Path, pairs: tuple[str, ...]) -> Any:
    """Return submitit's executor with the parameters of sbatch in `pairs`, name=value.

    Raises:
        ValueError: submitit or sbatch is missing, or a parameter is missing or unknown.
    """
    parameters = _parameters(pairs)
    try:
        import submitit
    except ImportError:
        raise InputError("--launcher slurm needs submitit: pip install 'earl-jax[slurm]'") from None
    if "time" not in parameters:
        raise InputError(
            "--launcher slurm needs a time limit in minutes: --slurm time=600 partition=... gpus_per_node=1"
        )
    if (out / LOGS).is_symlink():
        raise InputError(f"{out / LOGS} is a link, and a sweep writes through none; remove it")
    try:
        executor = submitit.SlurmExecutor(out.resolve() / LOGS, max_num_timeout=RETRIES)
        executor.update_parameters(**{"job_name": "earl-jax", **parameters})
    except RuntimeError as error:
        raise InputError(f"{error}; use --launcher slurm on a machine that has sbatch") from None
    except ValueError as error:
        raise InputError(" ".join(str(error).split())) from None
    return executor


def _parameters(pairs: tuple[str, ...]) -> dict[str, Any]:
    """Return name=value pairs as a dictionary, numbers as numbers."""
    parameters: dict[str, Any] = {}
    for pair in pairs:
        name, equals, text = pair.partition("=")
        if not equals or not name:
            raise InputError(f"--slurm takes name=value, not {pair!r}")
        parameters[name] = int(text) if text.lstrip("-").isdigit() else text
    return parameters
