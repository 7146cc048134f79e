"""Checkpoints of the whole train state of a run. A new checkpoint replaces an older one only when it is complete.

A checkpoint is a folder named by its step. It holds orbax trees of the lanes and of the written part of the replay, and
a manifest with a checksum of every file and of itself. It holds arrays only, and nothing is ever unpickled. The two
newest checkpoints are kept; if one is damaged, training continues from the other.

A train state is any `flax.struct` tree with the fields `lanes`, `replay` and `step`.
"""

import contextlib
import hashlib
import json
import logging
import shutil
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.errors import InputError
from earl_jax.runs.files import DamagedWarning, inside
from earl_jax.runs.hosts import first_host, gathered
from earl_jax.runs.snapshot import filled, plain, spread, typed

MANIFEST = "manifest.json"
KEPT = 2
SPARE = 1 << 20
"""Bytes of a checkpoint in addition to its arrays, with room for subsequent rows of metrics."""


class DamagedError(InputError):
    """A checkpoint does not match its checksums."""


def save(folder: Path, state: Any, span: slice = slice(None)) -> Path:
    """Write the lanes `span` of `state` to `folder/<step>` and return that path; the newest older checkpoint is kept.

    If lanes are on several hosts, all of them must call this, and the first one writes.

    Raises:
        OSError: the checkpoint could not be written; older ones are unchanged.
    """
    step = int(gathered(state.step))
    part, done = folder / f"part-{step}", folder / f"{step:09d}"
    lanes = gathered(plain(jax.tree.map(lambda leaf: leaf[span], state.lanes)))
    replay = filled(state.replay, span)
    if not first_host():
        return done
    try:
        for stale in folder.glob("part-*"):
            shutil.rmtree(stale)
        part.mkdir(parents=True)
        _require_room(part, [*lanes.values(), *replay.values()])
        _write(part / "lanes", lanes)
        _write(part / "replay", replay)
        (part / MANIFEST).write_text(_manifest({"step": step, "lanes": _described(lanes), "files": _checksums(part)}))
    except Exception as error:  # orbax raises various exceptions if the disk is full
        shutil.rmtree(part, ignore_errors=True)
        cause = str(error).strip().splitlines()[0] if str(error).strip() else repr(error)
        raise OSError(f"checkpoint {done} can't be written: {cause}; older checkpoints are unchanged") from error
    older = [path for path in _checkpoints(folder) if path != done]
    shutil.rmtree(done, ignore_errors=True)
    part.rename(done)
    for path in older[: 1 - KEPT]:
        shutil.rmtree(path)
    return done


def _require_room(folder: Path, arrays: Sequence[np.ndarray]) -> None:
    """Raise an OSError if the disk has too little space: orbax's threads continue for a while after a failed write."""
    needed, free = sum(array.nbytes for array in arrays) + SPARE, shutil.disk_usage(folder).free
    if free < needed:
        raise OSError(f"it needs up to {needed / 1e6:,.1f} MB, but {free / 1e6:,.1f} MB are free")


def newest(folder: Path) -> int:
    """Return the step of the newest checkpoint in `folder`, or 0 if there is none."""
    paths = _checkpoints(folder)
    return int(paths[-1].name) if paths else 0


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
            manifests = [verified(path) for path in paths]
        except DamagedError as error:
            causes.append(str(error))
            continue
        state = _read_state(paths, manifests, sizes, like, with_replay)
        if causes:
            warnings.warn(f"{'; '.join(causes)}; continuing from {paths[0].name}", DamagedWarning, stacklevel=2)
        return state
    raise InputError(f"{'; '.join(causes)}; no older checkpoint is intact")


def _common_checkpoints(folders: Sequence[Path]) -> list[list[Path]]:
    """Return the paths in all `folders` for each step at which all of them have a checkpoint, newest first."""
    by_name = [{path.name: path for path in _checkpoints(folder)} for folder in folders]
    common = set.intersection(*map(set, by_name))
    return [[paths[name] for paths in by_name] for name in sorted(common, reverse=True)]


def _read_state(
    paths: Sequence[Path], manifests: Sequence[dict], sizes: Sequence[int], like: Any, with_replay: bool
) -> Any:
    lanes = [_read_lanes(*checkpoint, like) for checkpoint in zip(paths, manifests, sizes, strict=True)]
    replay = like.replay
    if with_replay:
        replay = spread([_read(path / "replay", None) for path in paths], sizes, like.replay)
    joined = jax.tree.map(lambda *parts: jnp.concatenate(parts), *lanes)
    return like.replace(lanes=joined, replay=replay, step=jnp.asarray(int(paths[0].name), jnp.int32))


def _read_lanes(path: Path, manifest: dict[str, Any], size: int, like: Any) -> Any:
    """Return the `size` lanes of the checkpoint at `path`."""
    shapes = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct((size, *leaf.shape[1:]), leaf.dtype), like.lanes)
    expected = plain(shapes)
    if manifest["lanes"] != _described(expected):
        raise InputError(f"checkpoint {path} does not belong to this run: its arrays have other shapes")
    return typed(_read(path / "lanes", expected), shapes)


def _checkpoints(folder: Path) -> list[Path]:
    if not folder.is_dir():
        return []
    return sorted(path for path in folder.glob("*") if path.name.isdigit() and not path.is_symlink())


def _checksums(folder: Path) -> dict[str, str]:
    files = sorted(path for path in folder.rglob("*") if path.is_file() and path.name != MANIFEST)
    return {str(path.relative_to(folder)): _checksum(path) for path in files}


def _checksum(path: Path) -> str:
    with path.open("rb") as handle:
        return hashlib.file_digest(handle, "blake2b").hexdigest()


def _manifest(body: dict[str, Any]) -> str:
    """Return `body` as text, with its checksum."""
    return json.dumps({**body, "checksum": _sum_of(body)})


def _sum_of(body: dict[str, Any]) -> str:
    return hashlib.blake2b(json.dumps(body, sort_keys=True).encode()).hexdigest()


def verified(path: Path) -> dict[str, Any]:
    """Return the manifest of the checkpoint at `path` after a check of all its files.

    Raises:
        DamagedError: a file is missing or does not match its checksum; the message names it.
    """
    try:
        manifest = json.loads((path / MANIFEST).read_text())
        if manifest.pop("checksum") != _sum_of(manifest):
            raise InputError("it does not match its checksum")
        files = dict(manifest["files"])
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise DamagedError(f"checkpoint {path} is damaged: {MANIFEST} cannot be read ({error})") from error
    if manifest["step"] != int(path.name):
        raise DamagedError(f"checkpoint {path} is damaged: {MANIFEST} names step {manifest['step']}")
    for name, expected in files.items():
        try:
            file = inside(path, name)
        except ValueError as error:
            raise DamagedError(f"checkpoint {path} is damaged: {error}") from error
        if not file.is_file():
            raise DamagedError(f"checkpoint {path} is damaged: {name} is missing")
        if _checksum(file) != expected:
            raise DamagedError(f"checkpoint {path} is damaged: {name} does not match its checksum")
    return manifest


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

    with _checkpointer() as checkpointer:
        return checkpointer.restore(path.resolve(), args=ocp.args.StandardRestore(like))
