"""Conversion of a train state to numbered plain arrays on the host, and back."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.algos.learner.replay import Replay
from earl_jax.runs.hosts import gathered

PIECE = 1 << 28
"""Bytes of the replay that are copied from a device at a time."""


def _is_key(leaf: Any) -> bool:
    return jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)


def plain(tree: Any) -> Any:
    """Return `tree` as numbered arrays or shapes: PRNG keys as words, no empty leaves, which orbax rejects."""

    def convert(leaf):
        if not _is_key(leaf):
            return leaf
        is_shape = isinstance(leaf, jax.ShapeDtypeStruct)
        return jax.eval_shape(jax.random.key_data, leaf) if is_shape else jax.random.key_data(leaf)

    return {f"{number:03d}": convert(leaf) for number, leaf in enumerate(jax.tree.leaves(tree)) if leaf.size}


def typed(leaves: dict[str, Any], like: Any) -> Any:
    """Return the `plain` arrays `leaves` as a tree of the structure of `like`."""
    shapes, structure = jax.tree.flatten(like)

    def restore_leaf(number, shape):
        if not shape.size:
            return jnp.zeros(shape.shape, shape.dtype)
        leaf = leaves[f"{number:03d}"]
        return jax.random.wrap_key_data(leaf) if _is_key(shape) else jnp.asarray(leaf)

    return jax.tree.unflatten(structure, [restore_leaf(*pair) for pair in enumerate(shapes)])


def filled(replay: Replay, span: slice) -> dict[str, np.ndarray]:
    """Return the written part of the replay for the lanes `span`, as the arrays of a checkpoint.

    `mine` and `other` are the filled parts of `index`, which belong to the first and the second controller. Of a replay
    that evicts transitions, all is saved.
    """
    row, slots, counts = int(gathered(replay.row)), len(replay.index), gathered(replay.counts)[span]
    next_row = row
    first, second = (int(count) for count in counts.max(axis=0))
    if replay.evicts:
        row = replay.capacity
        first = int(gathered(replay.demos)[0]) + row - int(gathered(replay.first_row)) - 1
        second = slots - first
    rows = {
        "state": _rows(replay.state, 0, row + 1, span),
        "action": _rows(replay.action, 0, row, span),
        "flags": _rows(replay.flags, 0, row, span),
        "reward": _rows(replay.reward, 0, row, span),
        "mine": _rows(replay.index, 0, first, span),
        "other": _rows(replay.index, slots - second, slots, span),
        "counts": counts,
        "demos": gathered(replay.demos),
        "row": np.asarray(next_row, np.int32),
        "first_row": gathered(replay.first_row),
        "oldest": gathered(replay.oldest)[span],
    }
    return {name: array for name, array in rows.items() if array.size}


def _rows(array: jax.Array, start: int, stop: int, span: slice) -> np.ndarray:
    """Return rows `start` to `stop` of the lanes `span` on the host.

    They are copied in pieces, because one slice could need as much device memory again.
    """
    stop = min(stop, len(array))
    step = max(1, PIECE // max(1, array.nbytes // max(1, len(array))))
    pieces = [gathered(array[first : min(first + step, stop), span]) for first in range(start, stop, step)]
    return np.concatenate(pieces) if pieces else gathered(array[:0, span])


def spread(parts: Sequence[dict[str, np.ndarray]], sizes: Sequence[int], like: Replay) -> Replay:
    """Return the saved rows `parts`, with their `sizes` lanes joined, in a buffer of the capacity of `like`.

    The capacity can be larger than before. The buffer stays on the host; the caller moves it to devices.
    """
    names = ("state", "action", "flags", "reward", "index", "counts", "oldest")
    buffers = {name: np.zeros(getattr(like, name).shape, getattr(like, name).dtype) for name in names}
    targets = {"mine": buffers["index"], "other": buffers["index"][::-1]}
    start = 0
    for saved, size in zip(parts, sizes, strict=True):
        span = slice(start, start := start + size)
        buffers["counts"][span] = saved["counts"]
        buffers["oldest"][span] = saved.get("oldest", 0)
        for name in names[:4]:
            rows = saved.get(name)
            if rows is not None:
                buffers[name][: len(rows), span] = rows
        for name, target in targets.items():
            if name in saved:
                rows = saved[name] if name == "mine" else saved[name][::-1]
                target[: len(rows), span] = rows
    arrays: dict[str, Any] = {**buffers, **{name: parts[0][name] for name in ("demos", "row", "first_row")}}
    return Replay(**arrays)
