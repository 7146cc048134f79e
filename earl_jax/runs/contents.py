"""What is in a run folder: whether a run has results there, which entries are a run's own, and their removal."""

import os
import stat
from collections.abc import Iterator
from pathlib import Path

from earl_jax.errors import InputError
from earl_jax.runs.checkpoint import PARTS, PREFIX, is_checkpoint, saved_steps
from earl_jax.runs.files import LOCK, PART, entries, remove, require_plain
from earl_jax.runs.table import complete_lines, table_text

CONFIG, METRICS, POLICIES, CHECKPOINTS = "config.json", "metrics.csv", "policies.npz", "checkpoints"
TENSORBOARD, WANDB = "tensorboard", "wandb"
FILES = (CONFIG, METRICS, POLICIES)
EVENTS = "events.out.tfevents."
"""What the names of TensorBoard's files start with."""
REMOVED = (CHECKPOINTS, TENSORBOARD, POLICIES, METRICS)
"""What a new run in the place of an earlier one removes, in an order in which a kill leaves no half run."""


def has_results(path: Path) -> bool:
    """Return whether a run in the folder at `path` has rows of metrics, policies or checkpoints."""
    if (path / POLICIES).exists() or saved_steps(path / CHECKPOINTS):
        return True
    table = path / METRICS
    text = table_text(table)
    return len(complete_lines(table)) > 1 or (bool(text) and not text.startswith("step"))


def unknown_entries(path: Path) -> list[str]:
    """Return the entries of the folder at `path`, and of the folders of a run in it, that no run writes."""
    if not path.is_dir():
        return []
    return sorted(str(entry.relative_to(path)) for entry in _unknown(path))


def _unknown(path: Path) -> Iterator[Path]:
    known = {LOCK, WANDB, *FILES, *(name + PART for name in FILES)}
    for entry in entries(path):
        if entry.is_symlink():
            yield entry
        elif entry.name == CHECKPOINTS and entry.is_dir():
            yield from _unknown_checkpoints(entry)
        elif entry.name == TENSORBOARD and entry.is_dir():
            yield from (file for file in entries(entry) if file.is_symlink() or not file.name.startswith(EVENTS))
        elif entry.name not in known:
            yield entry


def _unknown_checkpoints(folder: Path) -> Iterator[Path]:
    for entry in entries(folder):
        if is_checkpoint(entry):
            yield from (part for part in entries(entry) if part.is_symlink() or part.name not in PARTS)
        elif not entry.name.startswith(PREFIX) or entry.is_symlink():
            yield entry


def require_plain_entries(path: Path) -> None:
    """Raise an InputError that names a link or a special file, if there is one where a run at `path` writes."""
    for name in (LOCK, *(name + end for name in FILES for end in ("", PART))):
        require_plain(path / name)
    for name in (CHECKPOINTS, TENSORBOARD, WANDB):
        require_plain(path / name, stat.S_IFDIR)
    for entry in _below(path):
        if entry.is_symlink():
            raise InputError(f"{entry} is a link, and a run writes through none; remove it")


def _below(path: Path) -> Iterator[Path]:
    """Yield all entries of the folders in which a run writes."""
    for name in (CHECKPOINTS, TENSORBOARD):
        for top, folders, files in os.walk(path / name):
            yield from (Path(top) / entry for entry in folders + files)


def clear(folder: Path) -> list[str]:
    """Remove what an earlier run in `folder` left except its config, and return the names of what was there."""
    names = {entry.name for entry in entries(folder)}
    removed = [name for name in (*REMOVED, *(file + PART for file in FILES)) if name in names]
    for name in removed:
        remove(folder / name)
    return removed
