"""The origin of a run, which config.json records: time, versions, machine and commit."""

import datetime
import platform
import subprocess
from importlib import metadata
from pathlib import Path
from typing import Any

import jax

PACKAGES = ("earl-jax", "jax", "jaxlib", "flax", "optax", "orbax-checkpoint", "brax", "mujoco", "mujoco-mjx", "numpy")


def provenance() -> dict[str, Any]:
    """Return the time (UTC), versions, platform and commit of a new run."""
    versions = {}
    for package in PACKAGES:
        try:
            versions[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            versions[package] = None
    return {
        "created": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "versions": versions,
        "python": platform.python_version(),
        "backend": jax.default_backend(),
        "device": jax.devices()[0].device_kind,
        "commit": _commit(),
    }


def _commit() -> str | None:
    """Return the commit of this package's checkout, or None if it is installed from a wheel."""
    package = Path(__file__).resolve().parents[1]
    command = ["git", "-C", str(package), "log", "-1", "--format=%H", "--", str(package)]
    try:
        return subprocess.run(command, capture_output=True, text=True, timeout=10).stdout.strip() or None
    except (OSError, subprocess.TimeoutExpired):
        return None
