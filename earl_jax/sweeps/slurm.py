"""The SLURM launcher of sweeps: an array job with a task for each program group."""

import contextlib
import json
import shlex
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

from earl_jax.errors import InputError
from earl_jax.options.environment import module_path
from earl_jax.options.values import counted
from earl_jax.sweeps.processes import WORKER, Task

LOGS = "slurm"
"""Name of the folder, in that of the sweep, for the tasks and the logs of arrays."""
RETRIES = 100
"""How often a job that reaches its time limit returns to the queue."""
OWN = "array", "open-mode", "output"
"""Options of sbatch that the launcher sets."""
DEFAULTS = {"job-name": "earl-jax", "signal": "B:USR1@90"}
"""Options of sbatch that others replace. The signal gives a worker 90 seconds before the time limit to save."""


def submit(out: Path, tasks: list[Task], options: dict[str, str], emit: Callable[[str], None]) -> None:
    """Submit `tasks`, one for each program group of the sweep at `out`, as an array job.

    Raises:
        ValueError: sbatch is missing or refuses one of its `options`; nothing has been submitted.
    """
    folder = out.resolve() / LOGS
    if (out / LOGS).is_symlink():
        raise InputError(f"{out / LOGS} is a link, and a sweep does not write through links; remove it")
    if tasks:
        job = _sbatch(folder, tasks, options)
        for number, task in enumerate(tasks):
            for name in task["runs"]:
                emit(f"submitted  {name}  job {job}_{number}")
    later = f"logs in {folder}; when they have ended, repeat the command to submit unfinished runs"
    emit(f"{counted(len(tasks), 'job')}; {later if tasks else 'no run is unfinished'}")


def options_of(pairs: tuple[str, ...]) -> dict[str, str]:
    """Return the options of sbatch of name=value `pairs`, with the defaults that they replace.

    `array_parallelism` is the number of tasks that run at once.

    Raises:
        ValueError: a pair is none, or names an option that the launcher sets.
    """
    options = dict(DEFAULTS)
    for pair in pairs:
        name, equals, text = pair.partition("=")
        if not equals or not name:
            raise InputError(f"--slurm takes name=value, not {pair!r}")
        option = name.replace("_", "-")
        if option in OWN:
            raise InputError(
                f"--slurm {name}: the launcher sets it; array_parallelism limits the tasks that run at once"
            )
        options[option] = text
    return options


def _sbatch(folder: Path, tasks: list[Task], options: dict[str, str]) -> str:
    """Return the number of the array job that trains `tasks`, after its submission. Errors as `submit`."""
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile("w", dir=folder, prefix="tasks-", suffix=".jsonl", delete=False) as file:
        file.writelines(f"{json.dumps(task)}\n" for task in tasks)
    log = str(folder).replace("%", "%%") + "/%A_%a.log"
    given = dict(options)
    at_once = given.pop("array-parallelism", "")
    given |= {"output": log, "open-mode": "append", "array": f"0-{len(tasks) - 1}" + (f"%{at_once}" if at_once else "")}
    arguments = ["--parsable", "--requeue", *(f"--{name}={text}" for name, text in given.items())]
    try:
        submitted = subprocess.run(
            ["sbatch", *arguments], input=_script(file.name), capture_output=True, text=True, check=True
        )
    except (OSError, subprocess.CalledProcessError) as error:
        Path(file.name).unlink()
        with contextlib.suppress(OSError):  # it holds earlier arrays
            folder.rmdir()
        reason = error.stderr if isinstance(error, subprocess.CalledProcessError) else f"{error}"
        raise InputError(f"--launcher slurm cannot submit a job: {' '.join(reason.split())}") from None
    return submitted.stdout.strip().partition(";")[0]  # a federation adds the name of the cluster


def _script(tasks: str) -> str:
    """Return the batch script that trains one of the groups in the file `tasks`.

    USR1 announces the time limit: the worker saves, and the job returns to the queue. SLURM sends TERM to the worker too.
    A trap ends `wait`, so the script waits until the worker has ended.
    """
    return f"""#!/bin/bash
trap 'echo "the time limit is near"; limit=yes; kill -TERM $worker' USR1
trap : TERM
PYTHONPATH={shlex.quote(module_path())} {shlex.join(WORKER)} {shlex.quote(tasks)} $SLURM_ARRAY_TASK_ID &
worker=$!
until wait $worker; code=$?; ! kill -0 $worker 2>/dev/null; do :; done
if [ "$limit" ] && [ $code != 0 ] && [ "${{SLURM_RESTART_COUNT:-0}}" -lt {RETRIES} ]; then
  scontrol requeue ${{SLURM_ARRAY_JOB_ID}}_$SLURM_ARRAY_TASK_ID
fi
exit $code
"""
