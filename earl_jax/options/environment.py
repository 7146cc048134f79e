"""What a process may use on its machine: cores, a share of a device's memory, jax (not imported), other processes."""

import os
import sys
from pathlib import Path

FRACTION = "XLA_PYTHON_CLIENT_MEM_FRACTION"
"""Environment variable of jax: the share of a GPU's memory that this process may use."""
PER_DEVICE = "EARL_JAX_PER_DEVICE"
"""Environment variable of a sweep's worker: the number of programs that share its GPU, or the memory without a GPU."""
PYTHON = (sys.executable, "-P")
"""The command of another Python process. With -P, a json.py in the current folder does not replace Python's own."""
CPU_LIMIT = Path("/sys/fs/cgroup/cpu.max")
"""File with the core microseconds that a container may use per period (`max`: no limit), and the period's length."""


def own_cores() -> list[int]:
    """Return the numbers of the cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


def core_count() -> int:
    """Return the number of cores that this process may keep busy: its own cores, or fewer in a limited container."""
    try:
        quota, period = map(int, CPU_LIMIT.read_text().split())
    except (OSError, ValueError):
        return len(own_cores())
    return max(1, min(len(own_cores()), quota // period))


def module_path() -> str:
    """Return the PYTHONPATH with which another process finds the same modules as this one."""
    return os.pathsep.join(sys.path)


def start_failure(error: Exception) -> str | None:
    """Return `error` as one line with jax's variables if jax cannot be imported or has no device, else None."""
    given = ", ".join(f"{name}={value}" for name, value in sorted(os.environ.items()) if name.startswith("JAX_"))
    try:
        import jax

        jax.jit(lambda: 0)()
    except Exception:
        cause = " ".join(str(error).split()) or "it finds no device"
        return f"jax does not start with {given}: {cause}; correct or unset the variable" if given else None
    return None
