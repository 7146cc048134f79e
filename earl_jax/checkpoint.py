"""Checkpoints: the whole state of a run, written beside the last one and put in its place only when whole.

A checkpoint is a folder named by its step: orbax trees for the lanes and for the filled part of the replay, and a manifest
with a checksum of every file. Arrays only; nothing is ever unpickled.
"""

import hashlib
import json
import shutil
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.algos.autonomy import Lives
from earl_jax.algos.replay import Replay

MANIFEST = "manifest.json"


def save(folder: Path, lives: Lives) -> Path:
    """Write `lives` to `folder/<step>` and return that path; older checkpoints go once the new one is whole."""
    step = int(lives.step)
    part, done = folder / f"part-{step}", folder / f"{step:09d}"
    for stale in folder.glob("part-*"):
        shutil.rmtree(stale)
    part.mkdir(parents=True)
    lanes = _plain(lives.lanes)
    _write(part / "lanes", lanes)
    _write(part / "replay", _filled(lives.replay))
    manifest = {"step": step, "lanes": _described(lanes), "files": _checksums(part)}
    (part / MANIFEST).write_text(json.dumps(manifest))
    older = _found(folder)
    shutil.rmtree(done, ignore_errors=True)
    part.rename(done)
    for path in older:
        if path != done:
            shutil.rmtree(path)
    return done


def restore(folder: Path, like: Lives, with_replay: bool = True) -> Lives | None:
    """Return the newest checkpoint in `folder` in the form of `like` (shapes suffice), or None where there is none.

    With `with_replay=False` only the lanes are read and the replay is left as in `like`.

    Raises:
        ValueError: a file of the checkpoint is missing, changed or of another experiment; the message names it.
    """
    found = _found(folder)
    if not found:
        return None
    path = found[-1]
    manifest = _verified(path)
    wanted = _plain(like.lanes)
    if manifest["lanes"] != _described(wanted):
        raise ValueError(f"checkpoint {path} is not of this experiment: its arrays have other shapes")
    lanes = _typed(_read(path / "lanes", wanted), like.lanes)
    replay = _spread(_read(path / "replay", None), like.replay) if with_replay else like.replay
    return Lives(lanes, replay, jnp.asarray(manifest["step"], jnp.int32))


def _found(folder: Path) -> list[Path]:
    return sorted(path for path in folder.glob("*") if path.name.isdigit()) if folder.is_dir() else []


def _checksums(folder: Path) -> dict[str, str]:
    files = sorted(path for path in folder.rglob("*") if path.is_file() and path.name != MANIFEST)
    return {str(path.relative_to(folder)): _checksum(path) for path in files}


def _checksum(path: Path) -> str:
    with path.open("rb") as handle:
        return hashlib.file_digest(handle, "blake2b").hexdigest()


def _verified(path: Path) -> dict[str, Any]:
    """Return the manifest of a checkpoint whose every file is as it was written."""
    try:
        manifest = json.loads((path / MANIFEST).read_text())
        files = dict(manifest["files"]) if int(manifest["step"]) and manifest["lanes"] else {}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ValueError(f"checkpoint {path} is damaged: {MANIFEST} cannot be read ({error})") from error
    for name, expected in files.items():
        file = path / name
        if not file.is_file():
            raise ValueError(f"checkpoint {path} is damaged: {name} is missing")
        if _checksum(file) != expected:
            raise ValueError(f"checkpoint {path} is damaged: {name} is not what was written")
    return manifest


def _described(leaves: dict[str, Any]) -> dict[str, str]:
    return {name: f"{leaf.dtype}{list(leaf.shape)}" for name, leaf in leaves.items()}


def _write(path: Path, tree: Any) -> None:
    import orbax.checkpoint as ocp

    with ocp.StandardCheckpointer() as checkpointer:
        checkpointer.save(path.resolve(), jax.tree.map(np.asarray, tree))


def _read(path: Path, like: Any) -> Any:
    import orbax.checkpoint as ocp

    with ocp.StandardCheckpointer() as checkpointer:
        return checkpointer.restore(path.resolve(), like)


def _is_key(leaf: Any) -> bool:
    return jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)


def _plain(tree: Any) -> Any:
    """Return `tree` as numbered arrays or shapes, keys as their words, without empty leaves, which orbax refuses."""

    def plain(leaf):
        if not _is_key(leaf):
            return leaf
        is_shape = isinstance(leaf, jax.ShapeDtypeStruct)
        return jax.eval_shape(jax.random.key_data, leaf) if is_shape else jax.random.key_data(leaf)

    return {f"{number:03d}": plain(leaf) for number, leaf in enumerate(jax.tree.leaves(tree)) if leaf.size}


def _typed(leaves: dict[str, Any], like: Any) -> Any:
    wanted, structure = jax.tree.flatten(like)

    def typed(number, want):
        if not want.size:
            return jnp.zeros(want.shape, want.dtype)
        leaf = leaves[f"{number:03d}"]
        return jax.random.wrap_key_data(leaf) if _is_key(want) else jnp.asarray(leaf)

    return jax.tree.unflatten(structure, [typed(*pair) for pair in enumerate(wanted)])


def _filled(replay: Replay) -> dict[str, np.ndarray]:
    """Return the part of the replay that has been written; index rows of both controllers, counted from their ends."""
    row, capacity = int(replay.row), replay.capacity
    mine, other = (int(count) for count in np.asarray(replay.counts).max(axis=0))
    rows = {
        "state": np.asarray(replay.state[: row + 1]),
        "action": np.asarray(replay.action[:row]),
        "marks": np.asarray(replay.marks[:row]),
        "reward": np.asarray(replay.reward[:row]),
        "mine": np.asarray(replay.index[:mine]),
        "other": np.asarray(replay.index[capacity - other :]),
        "counts": np.asarray(replay.counts),
        "demos": np.asarray(replay.demos),
        "row": np.asarray(row, np.int32),
    }
    return {name: array for name, array in rows.items() if array.size}


def _spread(saved: dict[str, np.ndarray], like: Replay) -> Replay:
    """Return the saved rows in a buffer of the capacity of `like`, which may be larger than the saved one's."""

    def pad(name):
        want = getattr(like, name)
        buffer = np.zeros(want.shape, want.dtype)
        if name in saved:
            buffer[: len(saved[name])] = saved[name]
        return jnp.asarray(buffer)

    index = np.zeros(like.index.shape, like.index.dtype)
    for name, place in (("mine", slice(None, None)), ("other", slice(None, None, -1))):
        if name in saved:
            index[place][: len(saved[name])] = saved[name][place]
    rows = {name: pad(name) for name in ("state", "action", "marks", "reward")}
    whole = {name: jnp.asarray(saved[name]) for name in ("counts", "demos", "row")}
    return Replay(**rows, index=jnp.asarray(index), **whole)
