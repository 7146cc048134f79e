"""Import of recorded demonstrations of the original benchmark: untrusted pickles of numpy arrays, or npz files."""

import pickle
import zipfile
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from earl_jax.assets import DIRECTIONS, Demos
from earl_jax.errors import InputError

NUMPY_MODULES = (
    "numpy",
    "numpy.core.multiarray",
    "numpy._core.multiarray",
    "numpy.core.numeric",
    "numpy._core.numeric",
)
"""Modules under which pickles name the parts of an array, in numpy 1 and 2."""


class Recording(NamedTuple):
    """Concatenated episodes in the layout of the original.

    Float32 `observations [T, s + g]`, `actions [T, a]`, `rewards [T]` and `next_observations [T, s + g]`, and bool
    `terminals [T]`, which is true on the last transition of each episode.
    """

    observations: np.ndarray
    actions: np.ndarray
    rewards: np.ndarray
    next_observations: np.ndarray
    terminals: np.ndarray

    def episodes(self) -> list["Recording"]:
        """Return one recording for each episode."""
        stops = np.flatnonzero(self.terminals)[:-1] + 1
        parts = [np.split(field, stops) for field in self]
        return [Recording(*fields) for fields in zip(*parts, strict=True)]

    def demos(self) -> Demos:
        """Return the same transitions as `Demos`; state and goal are the two halves of an observation."""
        size = self.observations.shape[1] // 2
        states, goals = self.observations[:, :size], self.observations[:, size:]
        return Demos(
            states=states,
            goals=goals,
            actions=self.actions,
            next_states=self.next_observations[:, :size],
            rewards=self.rewards,
            ends=self.terminals,
        )


class _ArrayClass:
    """Placeholder for numpy's array class: a pickle may refer to that class but must not call it."""


def _reconstruct(array_class: Any, shape: tuple, typecode: Any) -> np.ndarray:
    if array_class is not _ArrayClass or tuple(shape) != (0,):
        raise pickle.UnpicklingError("it builds an array in an unusual way")
    return np.ndarray(shape, typecode)


def _encode(text: str, encoding: str) -> bytes:
    if encoding != "latin1":
        raise pickle.UnpicklingError(f"it encodes bytes as {encoding!r}, not as latin1")
    return text.encode("latin1")


def _frombuffer(data: Any, dtype: np.dtype, shape: Any, order: Any) -> np.ndarray:
    return np.frombuffer(data, dtype).reshape(shape, order=order).copy()


class ArrayUnpickler(pickle.Unpickler):
    """Reads pickles of plain containers and numpy arrays, and refuses any other name before anything is called."""

    def find_class(self, module: str, name: str) -> Any:
        """Return a safe replacement for a name that numpy puts in a pickle, and refuse any other name."""
        if (module, name) == ("_codecs", "encode"):
            return _encode
        allowed = {"ndarray": _ArrayClass, "dtype": np.dtype, "_reconstruct": _reconstruct, "_frombuffer": _frombuffer}
        if module in NUMPY_MODULES and name in allowed:
            return allowed[name]
        raise pickle.UnpicklingError(f"it asks for {module}.{name}, but only numpy arrays are allowed")

    def persistent_load(self, pid: Any) -> Any:
        """Refuse references to objects outside the file."""
        raise pickle.UnpicklingError("it refers to objects outside the file")


def unpickle(handle: BinaryIO) -> Any:
    """Return the content of a pickle of numpy arrays.

    Raises:
        ValueError: the pickle holds anything else, or is damaged; nothing in it was executed.
    """
    try:
        return ArrayUnpickler(handle).load()
    except Exception as error:  # a damaged pickle can raise any exception
        raise InputError(f"not a pickle of numpy arrays: {error}") from error


def read(path: Path) -> Recording:
    """Return the recording in a pickle of the original, or in an npz of the same five arrays.

    Raises:
        ValueError: the file is something else, or its arrays don't fit together; the message gives file and cause.
    """
    try:
        if zipfile.is_zipfile(path):
            with np.load(path, allow_pickle=False) as stored:
                return _checked({name: stored[name] for name in stored.files})
        with path.open("rb") as handle:
            return _checked(unpickle(handle))
    except (ValueError, zipfile.BadZipFile) as error:
        raise InputError(f"{path}: {error}") from error


def _checked(arrays: Any) -> Recording:
    if not isinstance(arrays, dict) or not set(Recording._fields) <= set(arrays):
        raise InputError(f"a recording has the arrays {', '.join(Recording._fields)}")
    parts = [np.asarray(arrays[name]) for name in Recording._fields]
    if any(part.dtype.kind not in "fiub" for part in parts):
        raise InputError("its arrays are not all numbers")
    rows = len(parts[0]) if parts[0].ndim else 0
    shapes = {name: part.shape for name, part in zip(Recording._fields, parts, strict=True)}
    flat = all(part.size == rows for part in (parts[2], parts[4]))
    matrices = all(part.ndim == 2 and len(part) == rows for part in (parts[0], parts[1], parts[3]))
    if not rows or not flat or not matrices or parts[0].shape != parts[3].shape or parts[0].shape[1] % 2:
        raise InputError(f"its arrays don't fit together: {shapes}")
    with np.errstate(over="ignore"):  # too large values become infinite, which the next check finds
        parts = [*(part.astype(np.float32) for part in parts[:4]), parts[4].astype(bool)]
    if not all(np.isfinite(part).all() for part in parts) or not parts[4].reshape(-1)[-1]:
        raise InputError("it has values that are not finite, or stops in the middle of an episode")
    observations, actions, rewards, next_observations, terminals = parts
    return Recording(
        observations=observations,
        actions=actions,
        rewards=rewards.reshape(-1),
        next_observations=next_observations,
        terminals=terminals.reshape(-1),
    )


def import_demos(files: dict[str, Path]) -> dict[str, Demos]:
    """Return the demonstrations in `files`, recordings by direction.

    Raises:
        ValueError: the direction is unknown, or a file is not a recording, as in `read`.
    """
    unknown = set(files) - set(DIRECTIONS)
    if unknown:
        raise InputError(f"unknown direction {', '.join(sorted(unknown))}; choose from {', '.join(DIRECTIONS)}")
    return {direction: read(path).demos() for direction, path in files.items()}
