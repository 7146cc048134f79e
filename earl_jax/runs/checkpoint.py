"""Checkpoints of the whole train state of a run.

A checkpoint is a folder named by its step, with the arrays of the lanes and of the written part of the replay. The two
newest are kept; if one is damaged, training continues from the other. Nothing is ever unpickled.

A train state is any `flax.struct` tree with the fields `lanes`, `replay` and `step`.
"""

import re
import shutil
import stat
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.errors import InputError
from earl_jax.runs.files import DamagedWarning, make_folder, require_plain
from earl_jax.runs.hosts import first_host, gathered
from earl_jax.runs.snapshot import filled, plain, spread, typed

PARTS = ("lanes", "replay", "_CHECKPOINT_METADATA", "commit_success.txt")
"""What is in a checkpoint."""
UNFINISHED = ".orbax-checkpoint-tmp"
"""What the names of checkpoints contain until they are complete."""
NAME = re.compile("[0-9]{9,10}")


class DamagedError(InputError):
    """A checkpoint cannot be read, or does not match its checksums."""


def save(folder: Path, state: Any, span: slice = slice(None)) -> Path:
    """Write the lanes `span` of `state` to `folder/<step>` and return that path; the newest older checkpoint is kept.

    If lanes are on several hosts, all of them must call this, and the first one writes.

    Raises:
        OSError: the checkpoint could not be written; older ones are unchanged.
    """
    from earl_jax.runs import archive  # Orbax takes a second to import

    step = int(gathered(state.step))
    done = folder / f"{step:09d}"
    lanes = gathered(plain(jax.tree.map(lambda leaf: leaf[span], state.lanes)))
    replay = filled(state.replay, span)
    if not first_host():
        return done
    try:
        make_folder(folder)
        archive.write(folder, step, {"lanes": {**lanes, "step": np.int32(step)}, "replay": replay})
    except Exception as error:  # Orbax raises various exceptions if the disk is full
        for part in folder.glob(f"*{UNFINISHED}*"):
            shutil.rmtree(part, ignore_errors=True)
        cause = _first_line(error)
        raise OSError(f"checkpoint {done} can't be written: {cause}; older checkpoints are unchanged") from error
    return done


def newest(folder: Path) -> int:
    """Return the step of the newest checkpoint in `folder`, or 0 if there is none."""
    return max(saved_steps(folder), default=0)


def saved_steps(folder: Path) -> list[int]:
    """Return the steps of the checkpoints in `folder`, sorted; a link in its place is an InputError."""
    require_plain(folder, stat.S_IFDIR)
    return sorted(int(path.name) for path in folder.iterdir() if is_checkpoint(path)) if folder.is_dir() else []


def is_checkpoint(path: Path) -> bool:
    """Return whether `path` is a folder with the name of a checkpoint."""
    return NAME.fullmatch(path.name) is not None and path.is_dir() and not path.is_symlink()


def restore(folder: Path, like: Any, with_replay: bool = True) -> Any:
    """Return the newest intact checkpoint in `folder` in the structure of `like` (shapes suffice), or None without one.

    `with_replay=False` reads the lanes only and keeps the replay of `like`. Warnings and errors as `restore_together`.
    """
    return restore_together([folder], [like.replay.counts.shape[0]], like, with_replay)


def restore_together(folders: Sequence[Path], sizes: Sequence[int], like: Any, with_replay: bool = True) -> Any:
    """Return the newest intact checkpoints of `folders`, with their `sizes` lanes joined, in the structure of `like`.

    The result is None if there are no checkpoints. If one is damaged, the previous ones are used, with a
    `DamagedWarning`.

    Raises:
        ValueError: no checkpoint is intact, their steps differ, or one belongs to another run; the message names the
            file.
    """
    latest = {newest(folder) for folder in folders}
    if len(latest) > 1:
        raise InputError(f"checkpoints of steps {sorted(latest)} can't continue in one program")
    causes = []
    for step in sorted(set.intersection(*(set(saved_steps(folder)) for folder in folders)), reverse=True):
        try:
            state = _read_state(folders, step, sizes, like, with_replay)
        except DamagedError as error:
            causes.append(str(error))
            continue
        if causes:
            warnings.warn(f"{'; '.join(causes)}; continuing from {step:09d}", DamagedWarning, stacklevel=2)
        return state
    if causes:
        raise InputError(f"{'; '.join(causes)}; no older checkpoint is intact")
    return None


def _read_state(folders: Sequence[Path], step: int, sizes: Sequence[int], like: Any, with_replay: bool) -> Any:
    names = ("lanes", "replay") if with_replay else ("lanes",)
    parts = [_read(folder, step, names) for folder in folders]
    lanes = [
        _lanes(folder / f"{step:09d}", part["lanes"], size, like.lanes)
        for folder, part, size in zip(folders, parts, sizes, strict=True)
    ]
    replay = like.replay
    if with_replay:
        try:
            replay = spread([part["replay"] for part in parts], sizes, like.replay)
        except (KeyError, ValueError, TypeError, IndexError) as error:
            path = folders[0] / f"{step:09d}"
            raise DamagedError(f"checkpoint {path} is damaged: its replay has other arrays ({error})") from error
    return like.replace(lanes=_joined(*lanes), replay=replay, step=jnp.asarray(step, jnp.int32))


@jax.jit
def _joined(*parts: Any) -> Any:
    """Return the lanes of all `parts`, by one program for all leaves."""
    return jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *parts)


def _read(folder: Path, step: int, names: Sequence[str]) -> dict[str, dict[str, np.ndarray]]:
    """Return the parts `names` of a checkpoint, which is of `step` by its own word."""
    from earl_jax.runs import archive

    path = folder / f"{step:09d}"
    try:
        parts = archive.read(folder, step, names)
        written = int(parts["lanes"].pop("step"))
    except Exception as error:  # Orbax raises various exceptions if files are missing
        raise DamagedError(f"checkpoint {path} is damaged: {_first_line(error)}") from error
    if written != step:
        raise DamagedError(f"checkpoint {path} is damaged: it is of step {written}")
    return parts


def _lanes(path: Path, arrays: dict[str, np.ndarray], size: int, like: Any) -> Any:
    """Return the `arrays` of the checkpoint at `path` as `size` lanes in the structure of `like`."""
    shapes = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct((size, *leaf.shape[1:]), leaf.dtype), like)
    expected = jax.eval_shape(plain, shapes)
    for name in expected.keys() & arrays.keys():
        if arrays[name].dtype == f"V{expected[name].dtype.itemsize}":  # as NumPy writes bfloat16
            arrays[name] = arrays[name].view(expected[name].dtype)
    if _described(arrays) != _described(expected):
        raise InputError(f"checkpoint {path} does not belong to this run: its arrays have other shapes")
    return typed(arrays, shapes)


def _described(leaves: dict[str, Any]) -> dict[str, str]:
    return {name: f"{leaf.dtype}{list(leaf.shape)}" for name, leaf in leaves.items()}


def _first_line(error: Exception) -> str:
    return (str(error).strip() or repr(error)).splitlines()[0]
