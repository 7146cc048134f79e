"""The contents of a run folder: whether it holds results, which entries belong to a run, and their removal."""

import itertools
import os
import re
import shutil
import stat
from collections.abc import Iterator
from pathlib import Path

from earl_jax.errors import InputError
from earl_jax.runs.checkpoint import NAME, PARTS, saved_steps
from earl_jax.runs.files import LOCK, PART, check_kind
from earl_jax.runs.table import lines_of

CONFIG, METRICS, POLICIES, CHECKPOINTS = "config.json", "metrics.csv", "policies.npz", "checkpoints"
TENSORBOARD, WANDB, VIDEOS = "tensorboard", "wandb", "videos"
FILES = (CONFIG, METRICS, POLICIES)
FOLDERS = (CHECKPOINTS, TENSORBOARD, WANDB, VIDEOS)
OWN_FILES = (*FILES, *(name + PART for name in FILES), LOCK)
OWN_NAMES = (
    *map(re.escape, (*OWN_FILES, *FOLDERS)),
    rf"{TENSORBOARD}/events\.out\.tfevents\.[^/]*",
    rf"{VIDEOS}/{NAME}\.gif({re.escape(PART)})?",
    rf"{CHECKPOINTS}/{NAME}(/({'|'.join(PARTS)})(/.*)?)?",
    rf"{CHECKPOINTS}/[^/]*{re.escape(PART)}.*",
    r"(.*/)?\.nfs[^/]*",  # NFS names deleted files so while another process reads them
)
"""Patterns of the paths that a run writes."""
REMOVED = (CHECKPOINTS, TENSORBOARD, VIDEOS, POLICIES, METRICS, *(name + PART for name in FILES))
"""What a new run in the place of an earlier one removes, in an order in which a kill leaves no half run."""


def is_run(path: str | Path) -> bool:
    """Return whether `path` is a run folder, which has a config."""
    return Path(str(path), CONFIG).is_file()


def has_results(path: Path) -> bool:
    """Return whether a run in the folder at `path` has rows of metrics, policies or checkpoints."""
    if (path / POLICIES).exists() or saved_steps(path / CHECKPOINTS):
        return True
    first, second, *_ = *itertools.islice(lines_of(path / METRICS), 2), "", ""
    return second.endswith("\n") or (bool(first) and not first.startswith("step"))


def unknown_entries(path: Path) -> list[str]:
    """Return the entries of the folder at `path`, and of the folders of a run in it, that no run writes, and links."""
    found = (*path.iterdir(), *_below(path)) if path.is_dir() else ()
    names = {str(entry.relative_to(path)): entry.is_symlink() for entry in found}
    return sorted(name for name, is_link in names.items() if is_link or not re.fullmatch("|".join(OWN_NAMES), name))


def _below(path: Path) -> Iterator[Path]:
    """Yield all entries of the folders in which a run writes, but for what another process removes meanwhile."""
    for name in (CHECKPOINTS, TENSORBOARD, VIDEOS):
        for folder, folders, files in os.walk(path / name):
            yield from (Path(folder, entry) for entry in (*folders, *files))


def check_entries(path: Path) -> None:
    """Raise an InputError that names a link, a special file or a table of another user, where a run at `path` writes."""
    for name in OWN_FILES:
        check_kind(path / name)
    for name in FOLDERS:
        check_kind(path / name, stat.S_IFDIR)
    for entry in filter(Path.is_symlink, _below(path)):
        raise InputError(f"{entry} is a link, and a run does not write through links; remove it")
    if (path / METRICS).exists() and not os.access(path / METRICS, os.W_OK):
        raise InputError(f"{path / METRICS} can't be written to: Permission denied; give this user the right to")


def clear(folder: Path) -> list[str]:
    """Remove what an earlier run in `folder` left except its config, and return the names of what was there."""
    removed = [name for name in REMOVED if os.path.lexists(folder / name)]
    for name in removed:
        path = folder / name
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    return removed
