"""Checkpoints: the whole state of a run, written beside the last one and put in its place only when whole.

A checkpoint is a folder named by its step: orbax trees for the lanes and for the filled part of the replay, and a manifest
with a checksum of every file and of itself. Arrays only; nothing is ever unpickled. The two newest are kept, so that one
that a disk has damaged costs the steps since the one before it and nothing else.
"""

import hashlib
import json
import shutil
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.algos.life import Lane, Lives
from earl_jax.algos.replay import Replay
from earl_jax.devices import first_host, gathered
from earl_jax.files import DamagedWarning, inside

MANIFEST = "manifest.json"
KEPT = 2
PIECE = 1 << 28
"""Bytes of the replay that leave a device at a time."""


class DamagedError(ValueError):
    """A checkpoint is not what was written."""


def save(folder: Path, lives: Lives, span: slice = slice(None)) -> Path:
    """Write lanes `span` of `lives` to `folder/<step>` and return that path; of older checkpoints the newest one stays.

    Where lanes live on several hosts all of them must call, and the first one writes.

    Raises:
        OSError: it could not be written; what was there before is untouched.
    """
    step = int(gathered(lives.step))
    part, done = folder / f"part-{step}", folder / f"{step:09d}"
    lanes = gathered(_plain(jax.tree.map(lambda leaf: leaf[span], lives.lanes)))
    replay = _filled(lives.replay, span)
    if not first_host():
        return done
    try:
        for stale in folder.glob("part-*"):
            shutil.rmtree(stale)
        part.mkdir(parents=True)
        _write(part / "lanes", lanes)
        _write(part / "replay", replay)
        (part / MANIFEST).write_text(_manifest({"step": step, "lanes": _described(lanes), "files": _checksums(part)}))
    except Exception as error:  # orbax has its own ways to say that a disk is full
        shutil.rmtree(part, ignore_errors=True)
        cause = str(error).strip().splitlines()[0] if str(error).strip() else repr(error)
        raise OSError(f"checkpoint {done} can't be written: {cause}; those before it are untouched") from error
    older = [path for path in _found(folder) if path != done]
    shutil.rmtree(done, ignore_errors=True)
    part.rename(done)
    for path in older[: 1 - KEPT]:
        shutil.rmtree(path)
    return done


def newest(folder: Path) -> int:
    """Return the step of the newest checkpoint in `folder`, 0 where there is none."""
    found = _found(folder)
    return int(found[-1].name) if found else 0


def restore(folder: Path, like: Lives, with_replay: bool = True) -> Lives | None:
    """Return the newest whole checkpoint in `folder` in the form of `like` (shapes suffice), or None where there is none.

    With `with_replay=False` only the lanes are read and the replay is left as in `like`. Warnings and errors as
    `restore_together`.
    """
    return restore_together([folder], [like.replay.counts.shape[0]], like, with_replay)


def restore_together(
    folders: Sequence[Path], sizes: Sequence[int], like: Lives, with_replay: bool = True
) -> Lives | None:
    """Return the newest whole checkpoints of `folders`, of `sizes` lanes, side by side in the form of `like`; None without any.

    One that is damaged is passed over for the one before it, with a `DamagedWarning`.

    Raises:
        ValueError: none is whole, or they are not of one step or of another experiment; the message names the file.
    """
    steps = {newest(folder) for folder in folders}
    if len(steps) > 1:
        raise ValueError(f"checkpoints of steps {sorted(steps)} can't go on in one program")
    if steps == {0}:
        return None
    causes = []
    for paths in _side_by_side(folders):
        try:
            manifests = [_verified(path) for path in paths]
        except DamagedError as error:
            causes.append(str(error))
            continue
        lives = _joined(paths, manifests, sizes, like, with_replay)
        if causes:
            warnings.warn(f"{'; '.join(causes)}; going on from {paths[0].name}", DamagedWarning, stacklevel=2)
        return lives
    raise ValueError(f"{'; '.join(causes)}; no older one is whole")


def _side_by_side(folders: Sequence[Path]) -> list[list[Path]]:
    """Return the checkpoints of all `folders` at each step that all of them have, newest first."""
    found = [{path.name: path for path in _found(folder)} for folder in folders]
    common = set.intersection(*map(set, found))
    return [[paths[name] for paths in found] for name in sorted(common, reverse=True)]


def _joined(
    paths: Sequence[Path], manifests: Sequence[dict], sizes: Sequence[int], like: Lives, with_replay: bool
) -> Lives:
    lanes = [_lanes(*each, like) for each in zip(paths, manifests, sizes, strict=True)]
    replay = like.replay
    if with_replay:
        replay = _spread([_read(path / "replay", None) for path in paths], sizes, like.replay)
    joined = jax.tree.map(lambda *parts: jnp.concatenate(parts), *lanes)
    return Lives(joined, replay, jnp.asarray(int(paths[0].name), jnp.int32))


def _lanes(path: Path, manifest: dict[str, Any], size: int, like: Lives) -> Lane:
    """Return the `size` lanes of the checkpoint at `path`."""
    form = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct((size, *leaf.shape[1:]), leaf.dtype), like.lanes)
    wanted = _plain(form)
    if manifest["lanes"] != _described(wanted):
        raise ValueError(f"checkpoint {path} is not of this experiment: its arrays have other shapes")
    return _typed(_read(path / "lanes", wanted), form)


def _found(folder: Path) -> list[Path]:
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
    """Return `body` as text, with a checksum of it."""
    return json.dumps({**body, "checksum": _sum_of(body)})


def _sum_of(body: dict[str, Any]) -> str:
    return hashlib.blake2b(json.dumps(body, sort_keys=True).encode()).hexdigest()


def _verified(path: Path) -> dict[str, Any]:
    """Return the manifest of a checkpoint whose every file is as it was written."""
    try:
        manifest = json.loads((path / MANIFEST).read_text())
        if manifest.pop("checksum") != _sum_of(manifest):
            raise ValueError("it is not what was written")
        files = dict(manifest["files"])
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise DamagedError(f"checkpoint {path} is damaged: {MANIFEST} cannot be read ({error})") from error
    if manifest["step"] != int(path.name):
        raise DamagedError(f"checkpoint {path} is damaged: {MANIFEST} speaks of step {manifest['step']}")
    for name, expected in files.items():
        try:
            file = inside(path, name)
        except ValueError as error:
            raise DamagedError(f"checkpoint {path} is damaged: {error}") from error
        if not file.is_file():
            raise DamagedError(f"checkpoint {path} is damaged: {name} is missing")
        if _checksum(file) != expected:
            raise DamagedError(f"checkpoint {path} is damaged: {name} is not what was written")
    return manifest


def _described(leaves: dict[str, Any]) -> dict[str, str]:
    return {name: f"{leaf.dtype}{list(leaf.shape)}" for name, leaf in leaves.items()}


def _checkpointer() -> Any:
    """Return orbax's checkpointer for arrays on this host alone: the first host writes, every host reads for itself."""
    import orbax.checkpoint as ocp

    me = jax.process_index()
    several = {"primary_host": me, "active_processes": {me}, "barrier_sync_key_prefix": f"host{me}"}
    options = ocp.options.MultiprocessingOptions(**(several if jax.process_count() > 1 else {}))
    return ocp.StandardCheckpointer(multiprocessing_options=options)


def _write(path: Path, tree: Any) -> None:
    with _checkpointer() as checkpointer:
        checkpointer.save(path.resolve(), jax.tree.map(np.asarray, tree))


def _read(path: Path, like: Any) -> Any:
    with _checkpointer() as checkpointer:
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


def _filled(replay: Replay, span: slice) -> dict[str, np.ndarray]:
    """Return the written part of lanes `span` of the replay; index rows of both controllers, counted from their ends."""
    row, capacity, counts = int(gathered(replay.row)), replay.capacity, gathered(replay.counts)[span]
    mine, other = (int(count) for count in counts.max(axis=0))
    rows = {
        "state": _rows(replay.state, 0, row + 1, span),
        "action": _rows(replay.action, 0, row, span),
        "marks": _rows(replay.marks, 0, row, span),
        "reward": _rows(replay.reward, 0, row, span),
        "mine": _rows(replay.index, 0, mine, span),
        "other": _rows(replay.index, capacity - other, capacity, span),
        "counts": counts,
        "demos": gathered(replay.demos),
        "row": np.asarray(row, np.int32),
    }
    return {name: array for name, array in rows.items() if array.size}


def _rows(array: jax.Array, start: int, stop: int, span: slice) -> np.ndarray:
    """Return rows `start` to `stop` of lanes `span` on the host, by pieces: a slice of it all would double a full device."""
    stop = min(stop, len(array))
    step = max(1, PIECE // max(1, array.nbytes // max(1, len(array))))
    pieces = [gathered(array[first : min(first + step, stop), span]) for first in range(start, stop, step)]
    return np.concatenate(pieces) if pieces else gathered(array[:0, span])


def _spread(parts: Sequence[dict[str, np.ndarray]], sizes: Sequence[int], like: Replay) -> Replay:
    """Return saved rows side by side in a buffer of the capacity of `like`, which may be larger than they had.

    It stays on the host: which device gets what part of it is for others to say.
    """
    names = ("state", "action", "marks", "reward", "index", "counts")
    buffers = {name: np.zeros(getattr(like, name).shape, getattr(like, name).dtype) for name in names}
    places = {"mine": buffers["index"], "other": buffers["index"][::-1]}
    start = 0
    for saved, size in zip(parts, sizes, strict=True):
        span = slice(start, start := start + size)
        buffers["counts"][span] = saved["counts"]
        for name in names[:4]:
            if name in saved:
                buffers[name][: len(saved[name]), span] = saved[name]
        for name, place in places.items():
            if name in saved:
                rows = saved[name] if name == "mine" else saved[name][::-1]
                place[: len(rows), span] = rows
    arrays: dict[str, Any] = {**buffers, **{name: parts[0][name] for name in ("demos", "row")}}
    return Replay(**arrays)
