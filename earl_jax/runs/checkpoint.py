"""Checkpoints of the whole train state of a run. A new checkpoint replaces an older one only when it is complete.

A checkpoint is a folder named by its step. It holds orbax trees of the lanes and of the written part of the replay, and
a manifest with a checksum of every file and of itself. It holds arrays only, and nothing is ever unpickled. The two
newest checkpoints are kept; if one is damaged, training continues from the other.

A train state is any `flax.struct` tree with the fields `lanes`, `replay` and `step`.
"""

import contextlib
import logging
import os
import re
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.errors import InputError
from earl_jax.runs.files import DamagedWarning, entries, make_folder, remove, write_atomically
from earl_jax.runs.hosts import first_host, gathered
from earl_jax.runs.manifest import MANIFEST, DamagedError, checksums, manifest_text, verified
from earl_jax.runs.snapshot import filled, plain, spread, typed

PARTS = ("lanes", "replay", MANIFEST)
"""What is in a checkpoint."""
PREFIX = "part-"
"""What the names of unfinished and of half removed checkpoints start with."""
NAME = re.compile("[0-9]{9,10}")
KEPT = 2
SPARE = 1 << 20
"""Bytes of a checkpoint in addition to its arrays, with room for subsequent rows of metrics."""


def save(folder: Path, state: Any, span: slice = slice(None)) -> Path:
    """Write the lanes `span` of `state` to `folder/<step>` and return that path; the newest older checkpoint is kept.

    If lanes are on several hosts, all of them must call this, and the first one writes.

    Raises:
        OSError: the checkpoint could not be written; older ones are unchanged.
    """
    step = int(gathered(state.step))
    done = folder / f"{step:09d}"
    lanes = gathered(plain(jax.tree.map(lambda leaf: leaf[span], state.lanes)))
    replay = filled(state.replay, span)
    if not first_host():
        return done
    try:
        make_folder(folder)
        _save(folder, done, lanes, replay)
    except Exception as error:  # orbax raises various exceptions if the disk is full
        cause = str(error).strip().splitlines()[0] if str(error).strip() else repr(error)
        raise OSError(f"checkpoint {done} can't be written: {cause}; older checkpoints are unchanged") from error
    return done


def _save(folder: Path, done: Path, lanes: dict[str, np.ndarray], replay: dict[str, np.ndarray]) -> None:
    part = folder / f"{PREFIX}{done.name}"
    for entry in entries(folder):
        if entry.name.startswith(PREFIX):
            _remove(entry)
    part.mkdir()
    try:
        _require_room(folder, [*lanes.values(), *replay.values()])
        _write(part / "lanes", lanes)
        _write(part / "replay", replay)
        manifest = {"step": int(done.name), "lanes": _described(lanes), "files": checksums(part)}
        write_atomically(part / MANIFEST, manifest_text(manifest))
    except Exception:
        _remove(part)
        raise
    older = [path for path in _checkpoints(folder) if path != done]
    _discard(done)
    part.rename(done)
    for path in older[: 1 - KEPT]:
        _discard(path)


def _discard(path: Path) -> None:
    """Remove a checkpoint; a kill in between does not leave it half removed under its name."""
    with contextlib.suppress(FileNotFoundError):
        _remove(path.rename(path.with_name(f"{PREFIX}removed-{path.name}")))


def _remove(path: Path) -> None:
    """Remove a folder as far as possible: on NFS, files that another process reads stay until the next checkpoint."""
    with contextlib.suppress(OSError):
        remove(path)


def _require_room(folder: Path, arrays: Sequence[np.ndarray]) -> None:
    """Raise an OSError if the disk has too little space: orbax's threads continue for a while after a failed write."""
    disk = os.statvfs(folder)
    needed, free = sum(array.nbytes for array in arrays) + SPARE, disk.f_bavail * disk.f_frsize
    if free < needed:
        raise OSError(f"it needs up to {needed / 1e6:,.1f} MB, but {free / 1e6:,.1f} MB are free")


def newest(folder: Path) -> int:
    """Return the step of the newest checkpoint in `folder`, or 0 if there is none."""
    return max(saved_steps(folder), default=0)


def saved_steps(folder: Path) -> list[int]:
    """Return the steps of the checkpoints in `folder`, sorted."""
    return [int(path.name) for path in _checkpoints(folder)]


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
    steps = {newest(folder) for folder in folders}
    if len(steps) > 1:
        raise InputError(f"checkpoints of steps {sorted(steps)} can't continue in one program")
    if steps == {0}:
        return None
    causes = []
    for paths in _common_checkpoints(folders):
        try:
            state = _read_state(paths, [verified(path) for path in paths], sizes, like, with_replay)
        except DamagedError as error:
            causes.append(str(error))
            continue
        if causes:
            warnings.warn(f"{'; '.join(causes)}; continuing from {paths[0].name}", DamagedWarning, stacklevel=2)
        return state
    raise InputError(f"{'; '.join(causes)}; no older checkpoint is intact")


def _common_checkpoints(folders: Sequence[Path]) -> list[list[Path]]:
    """Return the paths in all `folders` for each step at which all of them have a checkpoint, newest first."""
    by_name = [{path.name: path for path in _checkpoints(folder)} for folder in folders]
    common = set.intersection(*map(set, by_name))
    return [[paths[name] for paths in by_name] for name in sorted(common, key=int, reverse=True)]


def _read_state(
    paths: Sequence[Path], manifests: Sequence[dict], sizes: Sequence[int], like: Any, with_replay: bool
) -> Any:
    lanes = [_read_lanes(*checkpoint, like) for checkpoint in zip(paths, manifests, sizes, strict=True)]
    replay = like.replay
    if with_replay:
        replay = _read_replay(paths, sizes, like.replay)
    return like.replace(lanes=_joined(*lanes), replay=replay, step=jnp.asarray(int(paths[0].name), jnp.int32))


@jax.jit
def _joined(*parts: Any) -> Any:
    """Return the lanes of all `parts`, by one program for all leaves."""
    return jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *parts)


def _read_replay(paths: Sequence[Path], sizes: Sequence[int], like: Any) -> Any:
    parts = [_read(path / "replay", None) for path in paths]
    try:
        return spread(parts, sizes, like)
    except (KeyError, ValueError, TypeError, IndexError) as error:
        raise DamagedError(f"checkpoint {paths[0]} is damaged: its replay has other arrays ({error})") from error


def _read_lanes(path: Path, manifest: dict[str, Any], size: int, like: Any) -> Any:
    """Return the `size` lanes of the checkpoint at `path`."""
    shapes = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct((size, *leaf.shape[1:]), leaf.dtype), like.lanes)
    expected = plain(shapes)
    if manifest["lanes"] != _described(expected):
        raise InputError(f"checkpoint {path} does not belong to this run: its arrays have other shapes")
    return typed(_read(path / "lanes", expected), shapes)


def _checkpoints(folder: Path) -> list[Path]:
    """Return the checkpoints in `folder`, the oldest first."""
    paths = folder.iterdir() if folder.is_dir() else ()
    return sorted((path for path in paths if is_checkpoint(path)), key=lambda path: int(path.name))


def is_checkpoint(path: Path) -> bool:
    """Return whether `path` is a folder with the name of a checkpoint."""
    return NAME.fullmatch(path.name) is not None and path.is_dir() and not path.is_symlink()


def _described(leaves: dict[str, Any]) -> dict[str, str]:
    return {name: f"{leaf.dtype}{list(leaf.shape)}" for name, leaf in leaves.items()}


@contextlib.contextmanager
def _checkpointer() -> Iterator[Any]:
    """Yield orbax's checkpointer for arrays on this host alone; the first host writes, and every host reads.

    It is the blocking checkpointer, because the asynchronous one aborts when the clock jumps. Its log is silenced,
    because we report its errors in one line.
    """
    import orbax.checkpoint as ocp

    host = jax.process_index()
    one_host = {"primary_host": host, "active_processes": {host}, "barrier_sync_key_prefix": f"host{host}"}
    options = ocp.options.MultiprocessingOptions(**(one_host if jax.process_count() > 1 else {}))
    handler = ocp.StandardCheckpointHandler(multiprocessing_options=options)
    logger = logging.getLogger("absl")
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        with ocp.Checkpointer(handler, multiprocessing_options=options) as checkpointer:
            yield checkpointer
    finally:
        logger.setLevel(level)


def _write(path: Path, tree: Any) -> None:
    import orbax.checkpoint as ocp

    with _checkpointer() as checkpointer:
        checkpointer.save(path.resolve(), args=ocp.args.StandardSave(jax.tree.map(np.asarray, tree)))


def _read(path: Path, like: Any) -> Any:
    import orbax.checkpoint as ocp

    try:
        with _checkpointer() as checkpointer:
            return checkpointer.restore(path.resolve(), args=ocp.args.StandardRestore(like))
    except Exception as error:  # orbax raises various exceptions if files are missing
        cause = (str(error).strip() or repr(error)).splitlines()[0]
        raise DamagedError(f"checkpoint {path.parent} is damaged: {path.name} can't be read ({cause})") from error
