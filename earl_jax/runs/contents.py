"""What is in a run folder: whether a run has results there, which entries are a run's own, and their removal."""

import os
import shutil
import stat
from collections.abc import Iterator
from pathlib import Path

from earl_jax.errors import InputError
from earl_jax.runs.checkpoint import PARTS, UNFINISHED, is_checkpoint, saved_steps
from earl_jax.runs.files import LOCK, PART, require_plain
from earl_jax.runs.table import table_text

CONFIG, METRICS, POLICIES, CHECKPOINTS = "config.json", "metrics.csv", "policies.npz", "checkpoints"
TENSORBOARD, WANDB = "tensorboard", "wandb"
FILES = (CONFIG, METRICS, POLICIES)
OWN_FILES = (*FILES, *(name + PART for name in FILES), LOCK)
BUSY = ".nfs"
"""What the names start with that NFS gives to deleted files which another process still reads."""
EVENTS = "events.out.tfevents."
"""What the names of TensorBoard's files start with."""
REMOVED = (CHECKPOINTS, TENSORBOARD, POLICIES, METRICS, *(name + PART for name in FILES))
"""What a new run in the place of an earlier one removes, in an order in which a kill leaves no half run."""


def has_results(path: Path) -> bool:
    """Return whether a run in the folder at `path` has rows of metrics, policies or checkpoints."""
    if (path / POLICIES).exists() or saved_steps(path / CHECKPOINTS):
        return True
    text = table_text(path / METRICS)
    return text.count("\n") > 1 or (bool(text) and not text.startswith("step"))


def unknown_entries(path: Path) -> list[str]:
    """Return the entries of the folder at `path`, and of the folders of a run in it, that no run writes, and links."""
    return sorted(str(entry.relative_to(path)) for entry in _unknown(path)) if path.is_dir() else []


def _unknown(path: Path) -> Iterator[Path]:
    for entry in _entries(path):
        if entry.name == CHECKPOINTS and _is_folder(entry):
            yield from _unknown_checkpoints(entry)
        elif entry.name == TENSORBOARD and _is_folder(entry):
            yield from (file for file in _entries(entry) if file.is_symlink() or not file.name.startswith(EVENTS))
        elif entry.is_symlink() or entry.name not in (*OWN_FILES, WANDB):
            yield entry


def _unknown_checkpoints(folder: Path) -> Iterator[Path]:
    for entry in _entries(folder):
        if is_checkpoint(entry):
            yield from (part for part in _entries(entry) if part.is_symlink() or part.name not in PARTS)
        elif UNFINISHED not in entry.name or entry.is_symlink():
            yield entry


def _entries(folder: Path) -> list[Path]:
    return [entry for entry in folder.iterdir() if not entry.name.startswith(BUSY)]


def _is_folder(path: Path) -> bool:
    return path.is_dir() and not path.is_symlink()


def require_plain_entries(path: Path) -> None:
    """Raise an InputError that names a link or a special file, if there is one where a run at `path` writes."""
    for name in OWN_FILES:
        require_plain(path / name)
    for name in (CHECKPOINTS, TENSORBOARD, WANDB):
        require_plain(path / name, stat.S_IFDIR)
    for name in (CHECKPOINTS, TENSORBOARD):
        for top, folders, files in os.walk(path / name):
            for entry in (Path(top, name) for name in folders + files):
                if entry.is_symlink():
                    raise InputError(f"{entry} is a link, and a run writes through none; remove it")


def clear(folder: Path) -> list[str]:
    """Remove what an earlier run in `folder` left except its config, and return the names of what was there."""
    removed = [name for name in REMOVED if os.path.lexists(folder / name)]
    for name in removed:
        path = folder / name
        shutil.rmtree(path) if _is_folder(path) else path.unlink()
    return removed
