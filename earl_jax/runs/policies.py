"""The file policies.npz of a run folder: task actors and visited positions of all seeds at the newest evaluation.

It holds `step`, `seeds` [N], `obs_size`, `action_size` (those of the task without help), the leaves of the actors
[N, ...], named by their paths in the tree, such as `actor['params']['hidden_0']['kernel']`, and, where the task has a
map, `visits` [N, B, B], int32, which a file that is published can lack.
"""

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from earl_jax.errors import InputError
from earl_jax.npz import MAX_BYTES, load_npz
from earl_jax.runs.files import read_bytes, write_atomically


def save_policies(
    path: Path,
    actors: Any,
    step: int,
    seeds: Sequence[int],
    obs_size: int,
    action_size: int,
    visits: np.ndarray | None = None,
) -> None:
    """Write the tree `actors`, leaves [N, ...], what is needed to use it, and the maps `visits [N, B, B]` to `path`.

    Raises:
        OSError: the file could not be written; an older one is unchanged.
    """
    maps = {} if visits is None else {"visits": visits}
    buffer = io.BytesIO()
    np.savez(buffer, step=step, seeds=seeds, obs_size=obs_size, action_size=action_size, **maps, **_named(actors))
    write_atomically(path, buffer.getvalue())


def policies_step(path: Path) -> int:
    """Return the step of the policies at `path`, or 0 if there is no such file. Errors as `load_policies`."""
    return int(_read(path)["step"]) if path.exists() else 0


def policy_sizes(path: Path) -> tuple[int, int]:
    """Return the sizes of the observation and of the action of the policies at `path`. Errors as `load_policies`."""
    arrays = _read(path, sizes=("obs_size", "action_size"))
    return int(arrays["obs_size"]), int(arrays["action_size"])


def load_policies(path: Path, like: Any) -> Any:
    """Return the actors at `path` as a tree of NumPy arrays in the structure of `like`, whose leaves have shapes.

    A file may store its actors in float16; they are returned in the dtypes of `like`.

    Raises:
        ValueError: the file is damaged or has arrays of other shapes; the message names it.
    """
    expected = _named(like)
    arrays = _read(path, list(expected))
    for name, leaf in expected.items():
        dtypes = (leaf.dtype, np.float16)  # half the size, for runs that are kept
        if name not in arrays or arrays[name].shape != leaf.shape or arrays[name].dtype not in dtypes:
            raise InputError(f"{path} does not belong to this run: {name} is not {leaf.dtype}{list(leaf.shape)}")
    leaves = [arrays[name].astype(leaf.dtype) for name, leaf in expected.items()]
    return jax.tree.unflatten(jax.tree.structure(like), leaves)


def load_visits(path: Path, seeds: int) -> np.ndarray | None:
    """Return the maps of visits at `path`, int [N, B, B] of N `seeds`, or None if the file has none.

    Raises:
        ValueError: the file is damaged, or its maps are not counts of N seeds on a square; the message names it.
    """
    visits = _read(path, ["visits"]).get("visits")
    if visits is None:
        return None
    square = visits.ndim == 3 and visits.shape[1] == visits.shape[2] > 0
    if not square or len(visits) != seeds or visits.dtype.kind not in "iu" or visits.min() < 0:
        raise InputError(f"{path} does not belong to this run: visits are not counts [{seeds}, B, B]")
    return visits


def _named(actors: Any) -> dict[str, Any]:
    return {f"actor{jax.tree_util.keystr(path)}": leaf for path, leaf in jax.tree_util.tree_leaves_with_path(actors)}


def _read(path: Path, names: Sequence[str] = (), sizes: Sequence[str] = ()) -> dict[str, np.ndarray]:
    """Return the number `step`, the positive numbers `sizes`, and the arrays `names` as far as the file has them."""
    try:
        arrays = load_npz(read_bytes(path, MAX_BYTES), ["step", *sizes, *names])
        for name in ("step", *sizes):
            array = arrays.get(name)
            if array is None or array.shape or array.dtype.kind not in "iu" or (name in sizes and array < 1):
                raise InputError(f"it has no {name}")
    except InputError as error:
        raise InputError(f"{path} is damaged: {error}; delete it to use the newest checkpoint") from error
    return arrays
