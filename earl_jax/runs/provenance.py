"""The origin of a run, which config.json records: time, versions, machine and commit."""

import datetime
import platform
import subprocess
from importlib import metadata
from pathlib import Path
from typing import Any

import jax

CHANGED = "-dirty"
"""The end of a commit whose files were changed, as `git describe --dirty` writes it."""
PACKAGES = ("earl-jax", "jax", "jaxlib", "flax", "optax", "orbax-checkpoint", "brax", "mujoco", "mujoco-mjx", "numpy")


def provenance() -> dict[str, Any]:
    """Return the time (UTC), versions, platform and commit, as `checkout_commit` gives it, of a new run."""
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
        "commit": checkout_commit(Path(__file__).resolve().parents[1]),
    }


def checkout_commit(package: Path) -> str | None:
    """Return the last commit of the folder `package` and of assets beside it, or None if git does not track them.

    It ends in `CHANGED` if files there were changed, added or removed since, except those that git ignores.
    """
    try:
        commit = _git(package, "log", "-1", "--format=%H")
        return commit + CHANGED * bool(_git(package, "status", "--porcelain")) if commit else None
    except (OSError, subprocess.SubprocessError):
        return None


def _git(package: Path, *command: str) -> str:
    """Return the output of a git command on `package` and assets, which writes nothing, not even the index."""
    paths = [str(package), str(package.parent / "assets")]
    git = ["git", "--no-optional-locks", "-C", str(package), *command, "--", *paths]
    return subprocess.run(git, capture_output=True, text=True, timeout=10, check=True).stdout.strip()


def short_commit(commit: str, digits: int = 9) -> str:
    """Return the first `digits` of a recorded commit, with the mark of a changed checkout if it has one."""
    full = commit.removesuffix(CHANGED)
    return full[:digits] + commit[len(full) :]
