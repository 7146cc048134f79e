"""Checkpoints of the whole train state of a run.

A checkpoint is a folder named by its step, with the arrays of the lanes and of the written part of the replay. The two
newest are kept; if one is damaged, training continues from the other. Nothing is ever unpickled.

A train state is any `flax.struct` tree with the fields `lanes`, `replay` and `step`.
"""

import contextlib
import math
import re
import shutil
import stat
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.envs.checks import first_difference
from earl_jax.errors import InputError
from earl_jax.runs import archive
from earl_jax.runs.files import PART, check_kind, make_folder, warn
from earl_jax.runs.hosts import first_host, gathered
from earl_jax.runs.snapshot import filled, named_arrays, spread, typed

PARTS = ("lanes", "replay")
"""What is in a checkpoint."""
NAME = "[0-9]{9,10}"


def save(folder: Path, state: Any, span: slice = slice(None)) -> Path:
    """Write the lanes `span` of `state` to `folder/<step>` and return that path; the newest older checkpoint is kept.

    If lanes are on several hosts, all of them must call this, and the first one writes.

    Raises:
        OSError: the checkpoint could not be written; older ones are unchanged.
    """
    step = int(gathered(state.step))
    done = folder / f"{step:09d}"
    lanes = gathered(named_arrays(jax.tree.map(lambda leaf: leaf[span], state.lanes)))
    replay = filled(state.replay, span, step)
    if not first_host():
        return done
    try:
        make_folder(folder)
        for unfinished in folder.glob(f"*{PART}*"):  # a kill left it
            shutil.rmtree(unfinished, ignore_errors=True)
        _write(folder, step, {"lanes": lanes, "replay": replay})
    except (OSError, ValueError) as error:
        cause = archive.first_line(error)
        raise OSError(f"checkpoint {done} can't be written: {cause}; older checkpoints are unchanged") from error
    return done


def _write(folder: Path, step: int, parts: dict[str, archive.Arrays]) -> None:
    """Write the checkpoint of `step` and keep the newest of the others; the first one in `folder` is read back."""
    older = [each for each in saved_steps(folder) if each != step]
    archive.write(folder, step, parts)
    if not older:
        archive.read(folder, step, dict.fromkeys(parts, math.inf))
    for each in older[:-1]:
        with contextlib.suppress(OSError):  # on NFS, files that another host reads stay
            shutil.rmtree(folder / f"{each:09d}")


def try_out(folder: Path) -> None:
    """Write a checkpoint without arrays below `folder`, read it and remove it; an OSError if the folder can hold none."""
    try:
        make_folder(folder)
        with tempfile.TemporaryDirectory(prefix=f"trial{PART}", dir=folder, ignore_cleanup_errors=True) as trial:
            _write(Path(trial), 0, {"lanes": {}, "replay": {}})
    except (OSError, ValueError) as error:
        cause = archive.first_line(error)
        raise OSError(f"{folder} can't hold checkpoints: {cause}; mend this, or choose another folder") from error


def newest(folder: Path) -> int:
    """Return the step of the newest checkpoint in `folder`, or 0 if there is none."""
    return max(saved_steps(folder), default=0)


def saved_steps(folder: Path) -> list[int]:
    """Return the steps of the checkpoints in `folder`, sorted; a link in its place is an InputError."""
    check_kind(folder, stat.S_IFDIR)
    found = [path for path in folder.iterdir() if re.fullmatch(NAME, path.name)] if folder.is_dir() else []
    return sorted(int(path.name) for path in found if path.is_dir() and not path.is_symlink())


def restore(folder: Path, like: Any, with_replay: bool = True) -> Any:
    """Return the newest intact checkpoint in `folder` in the structure of `like` (shapes suffice), or None without one.

    `with_replay=False` reads the lanes only and keeps the replay of `like`. Warnings and errors as `restore_together`.
    """
    return restore_together([folder], [like.replay.counts.shape[0]], like, with_replay)


def restore_together(folders: Sequence[Path], sizes: Sequence[int], like: Any, with_replay: bool = True) -> Any:
    """Return the newest intact checkpoints of `folders`, with their `sizes` lanes joined, in the structure of `like`.

    The result is None if there are no checkpoints. If one is damaged, the previous ones are used, with a `RunWarning`.

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
        except archive.DamagedError as error:
            causes.append(str(error))
            continue
        if causes:
            warn(f"{'; '.join(causes)}; continuing from {step:09d}")
        return state
    if causes:
        raise InputError(f"{'; '.join(causes)}; no older checkpoint is intact")
    return None


def _read_state(folders: Sequence[Path], step: int, sizes: Sequence[int], like: Any, with_replay: bool) -> Any:
    most = {}
    for name in PARTS if with_replay else PARTS[:1]:
        size = sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(getattr(like, name)))
        most[name] = (1 << 20) + 2 * size  # both lists of a replay can be as long as its index
    parts = [archive.read(folder, step, most) for folder in folders]
    lanes = _joined(folders, [part["lanes"] for part in parts], sizes, like.lanes)
    replay = like.replay
    if with_replay:
        try:
            replay = spread([part["replay"] for part in parts], sizes, like.replay)
        except (KeyError, ValueError, TypeError, IndexError) as error:
            raise archive.DamagedError(folders[0], step, f"its replay has other arrays ({error})") from error
    return like.replace(lanes=lanes, replay=replay, step=jnp.asarray(step, jnp.int32))


def _joined(folders: Sequence[Path], parts: Sequence[dict[str, np.ndarray]], sizes: Sequence[int], like: Any) -> Any:
    """Return the arrays `parts` of checkpoints in `folders`, with their `sizes` lanes joined, in the structure of `like`."""
    expected = jax.eval_shape(named_arrays, like)
    for folder, arrays, size in zip(folders, parts, sizes, strict=True):
        for name in expected.keys() & arrays.keys():
            if arrays[name].dtype == f"V{expected[name].dtype.itemsize}":  # as NumPy writes bfloat16
                arrays[name] = arrays[name].view(expected[name].dtype)
        wanted = {name: f"{leaf.dtype}{[size, *leaf.shape[1:]]}" for name, leaf in expected.items()}
        found = {name: f"{array.dtype}{[*array.shape]}" for name, array in arrays.items()}
        if found != wanted:
            name, there, here = first_difference(found, wanted)
            cause = f"{name} is {there} there and {here} here; have the task, the method or the learner changed?"
            raise InputError(f"a checkpoint in {folder} does not belong to this run: {cause}")
    return typed({name: np.concatenate([arrays[name] for arrays in parts]) for name in expected}, like)
