"""Submitit's executor for sweeps under SLURM, and its parameters."""

from pathlib import Path
from typing import Any

from earl_jax.errors import InputError

LOGS = "slurm"
"""Name of the folder, in that of the sweep, for submitit's scripts and logs."""
RETRIES = 100
"""How often a job that reaches its time limit returns to the queue."""


def slurm_executor(out: Path, parameters: dict[str, Any]) -> Any:
    """Return submitit's executor with `parameters` of sbatch.

    Raises:
        ValueError: submitit or sbatch is missing, or a parameter is missing or unknown.
    """
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


def sbatch_parameters(pairs: tuple[str, ...]) -> dict[str, Any]:
    """Return name=value pairs as a dictionary, numbers as numbers."""
    parameters: dict[str, Any] = {}
    for pair in pairs:
        name, equals, text = pair.partition("=")
        if not equals or not name:
            raise InputError(f"--slurm takes name=value, not {pair!r}")
        parameters[name] = int(text) if text.lstrip("-").isdigit() else text
    return parameters
