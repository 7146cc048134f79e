"""Conversion of a train state to plain arrays on the host, by name, and back."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.algos.learner.replay import Replay
from earl_jax.runs.hosts import gathered

PIECE = 1 << 28
"""Bytes of the replay that are copied from a device at a time."""
ROWS = ("state", "action", "flags", "reward")


def _is_key(leaf: Any) -> bool:
    return jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)


def named_arrays(tree: Any) -> dict[str, jax.Array]:
    """Return the leaves of `tree` by their paths, such as `.agent.actor`; PRNG keys are words."""
    return {
        jax.tree_util.keystr(path): jax.random.key_data(leaf) if _is_key(leaf) else leaf
        for path, leaf in jax.tree_util.tree_leaves_with_path(tree)
    }


def typed(leaves: dict[str, np.ndarray], like: Any) -> Any:
    """Return the named arrays `leaves` as a tree of the structure of `like`."""

    def restore_leaf(path, shape):
        leaf = jnp.asarray(leaves[jax.tree_util.keystr(path)])
        return jax.random.wrap_key_data(leaf) if _is_key(shape) else leaf

    return jax.tree_util.tree_map_with_path(restore_leaf, like)


def filled(replay: Replay, span: slice, steps: int) -> dict[str, np.ndarray]:
    """Return the part of the replay for the lanes `span` that `steps` steps have written, as the arrays of a checkpoint.

    `mine` and `other` are the filled parts of `index`, which belong to the first and the second controller. A replay that
    has evicted transitions is saved whole; before that, `oldest` is saved as of one that evicts none.
    """
    written, first_row = int(gathered(replay.row)), int(gathered(replay.first_row))
    slots, counts = len(replay.index), gathered(replay.counts)[span]
    first, second = (int(count) for count in counts.max(axis=0))
    oldest = gathered(replay.oldest)[span]
    if not replay.evicts or steps == written - first_row:
        oldest = oldest[:, :0]
    else:
        written = replay.capacity
        first = int(gathered(replay.demos)[0]) + written - first_row - 1
        second = slots - first
    return {
        "state": _rows(replay.state, 0, written + 1, span),
        **{name: _rows(getattr(replay, name), 0, written, span) for name in ROWS[1:]},
        "mine": _rows(replay.index, 0, first, span),
        "other": _rows(replay.index, slots - second, slots, span),
        "counts": counts,
        "demos": gathered(replay.demos),
        "row": gathered(replay.row),
        "first_row": gathered(replay.first_row),
        "oldest": oldest,
    }


def _rows(array: jax.Array, start: int, stop: int, span: slice) -> np.ndarray:
    """Return rows `start` to `stop` of the lanes `span` on the host.

    They are copied in pieces, because one slice could need as much device memory again. The pieces have powers of two of
    rows, because jax compiles and keeps a program for each size.
    """
    stop, pieces = min(stop, len(array)), [np.empty((0, *array[:0, span].shape[1:]), array.dtype)]
    most = max(1, PIECE // max(1, array.nbytes // max(1, len(array))))
    while start < stop:
        size = min(most, len(array), 1 << (stop - start - 1).bit_length())
        first = min(start, len(array) - size)
        pieces.append(gathered(array[first : first + size, span])[start - first : stop - first])
        start = first + size
    return np.concatenate(pieces)


def spread(parts: Sequence[dict[str, np.ndarray]], sizes: Sequence[int], like: Replay) -> Replay:
    """Return the saved rows `parts`, with their `sizes` lanes joined, in a buffer of the capacity of `like`.

    The capacity can be larger than before, and the buffer can evict transitions where it did not. It stays on the host;
    the caller moves it to devices.

    Raises:
        ValueError: an array has another shape or type, too many rows, or numbers of rows that are not there.
    """
    buffers: dict[str, Any] = {name: np.zeros(leaf.shape, leaf.dtype) for name, leaf in vars(like).items()}
    start = 0
    for saved, size in zip(parts, sizes, strict=True):
        _check(saved, size, like)
        span = slice(start, start := start + size)
        buffers["counts"][span] = saved["counts"]
        buffers["oldest"][span, : saved["oldest"].shape[1]] = saved["oldest"]
        for name in ROWS:
            buffers[name][: len(saved[name]), span] = saved[name]
        buffers["index"][: len(saved["mine"]), span] = saved["mine"]
        buffers["index"][len(like.index) - len(saved["other"]) :, span] = saved["other"]
    for name in ("demos", "row", "first_row"):
        buffers[name][...] = parts[0][name]
    return Replay(**buffers)


def _check(saved: dict[str, np.ndarray], lanes: int, like: Replay) -> None:
    """Raise a ValueError unless the arrays `saved` are rows of so many `lanes` in a buffer like `like`."""
    rows, places = len(saved["action"]), len(like.index)
    most = {"mine": rows - 1, "other": rows - 1, "row": rows, "first_row": rows, "demos": places, "counts": places}
    for name, leaf in {**vars(like), "mine": like.index, "other": like.index}.items():
        if name == "index":
            continue
        array, shape = saved[name], list(leaf.shape)
        if name in (*ROWS, "mine", "other"):
            shape[:2] = len(array), lanes
        elif name in ("counts", "oldest"):
            shape[0] = lanes
        if name == "oldest" and array.shape == (lanes, 0):  # it has evicted none
            continue
        if (array.dtype, list(array.shape)) != (leaf.dtype, shape):
            raise ValueError(f"{name} is {array.dtype}{list(array.shape)} instead of {leaf.dtype}{shape}")
        if array.dtype.kind == "i" and (array.min(initial=0) < 0 or array.max(initial=-1) > most.get(name, np.inf)):
            raise ValueError(f"{name} has numbers that are out of range")
