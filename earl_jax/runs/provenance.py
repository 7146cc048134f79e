"""The origin of a run, which config.json records: time, versions, machine, and the commit or the release."""

import base64
import csv
import datetime
import functools
import hashlib
import json
import platform
import subprocess
from importlib import metadata
from pathlib import Path
from typing import Any

import jax

CHANGED = "-dirty"
"""The end of a commit or of a release whose files were changed, as `git describe --dirty` writes it."""
PACKAGES = ("earl-jax", "jax", "jaxlib", "flax", "optax", "brax", "mujoco", "mujoco-mjx", "numpy")
NUMERIC = ("jax", "jaxlib", "flax", "optax", "mujoco", "mujoco-mjx")
"""Those of `PACKAGES` that compute the numbers of a run."""


def provenance() -> dict[str, Any]:
    """Return the time (UTC), versions, platform, and `checkout_commit` or `installed_release` of a new run."""
    return {
        "created": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "versions": {package: _version(package) for package in PACKAGES},
        "python": platform.python_version(),
        "backend": jax.default_backend(),
        "device": jax.devices()[0].device_kind,
        **_origin(),
    }


@functools.cache
def _origin() -> dict[str, str | None]:
    """Return the commit of this package, and the release that it was installed from, when this process first asks."""
    package = Path(__file__).resolve().parents[1]
    commit, release = checkout_commit(package), None
    if commit is None:
        release, commit = installed_release(package)
    return {"commit": commit, "release": release}


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def changed_versions(recorded: Any) -> str:
    """Return in words what is not as in a recorded provenance: this package's commit, and versions of packages of `NUMERIC`."""
    then = recorded.get("versions") if isinstance(recorded, dict) else None
    then = then if isinstance(then, dict) else {}
    now = {name: _version(name) for name in NUMERIC if name in then}
    if (made := made_by(recorded)) and (here := made_by(_origin())):  # another user's checkout has no commit for git
        then, now = {**then, "earl-jax": short_commit(made)}, {"earl-jax": short_commit(here), **now}
    return ", ".join(f"{name} {then[name]} (here {here})" for name, here in now.items() if then[name] != here)


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


def installed_release(package: Path) -> tuple[str | None, str | None]:
    """Return the version of the wheel that `package` was installed from, and its commit if that was built from a git URL.

    Both end in `CHANGED` if a module differs from the wheel's; they are None for a package that is not from a wheel.
    """
    try:
        wheel = metadata.distribution("earl-jax")
    except metadata.PackageNotFoundError:
        return None, None
    lines = (wheel.read_text("RECORD") or "").splitlines()  # wheel.files lacks removed files since Python 3.12
    recorded = [(name, known) for name, known, *_ in csv.reader(lines) if name.endswith(".py")]
    hashes = {Path(str(wheel.locate_file(name))).resolve(): known for name, known in recorded}
    if package / "__init__.py" not in hashes:
        return None, None
    mark = CHANGED * any(known and _sha256(path) != known for path, known in hashes.items())
    source = json.loads(wheel.read_text("direct_url.json") or "{}")
    commit = source.get("vcs_info", {}).get("commit_id")
    return wheel.version + mark, commit and commit + mark


def _sha256(path: Path) -> str | None:
    """Return the hash of a file as a wheel's RECORD has it, or None if it cannot be read."""
    try:
        digest = hashlib.sha256(path.read_bytes()).digest()
    except OSError:
        return None
    return "sha256=" + base64.urlsafe_b64encode(digest).decode().rstrip("=")


def made_by(values: Any) -> str:
    """Return the commit that a recorded provenance has, else its release, else an empty text."""
    return str(values.get("commit") or values.get("release") or "") if isinstance(values, dict) else ""


def short_commit(commit: str) -> str:
    """Return the first nine digits of a recorded commit, with the mark of a changed checkout if it has one."""
    full = commit.removesuffix(CHANGED)
    return full[:9] + commit[len(full) :]
