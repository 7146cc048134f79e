"""Import of recorded demonstrations of the original benchmark: untrusted pickles of numpy arrays, or npz files."""

import os
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np

from earl_jax.assets import MAX_BYTES, Demos, load_npz, read_bytes, shortened, spans
from earl_jax.errors import InputError

UNPICKLE = Path(__file__).with_name("unpickle.py")
LONGEST = 180
"""Seconds after which the reading of a pickle is stopped, where the system has no limit of its own."""


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
        return [Recording(*(field[span] for field in self)) for span in spans(self.terminals)]

    def demos(self) -> Demos:
        """Return the same transitions as `Demos`; state and goal are the two halves of an observation."""
        states, goals = np.split(self.observations, 2, axis=1)
        next_states, _ = np.split(self.next_observations, 2, axis=1)
        return Demos(states, goals, self.actions, next_states, self.rewards, self.terminals)


def read(path: Path) -> Recording:
    """Return the recording in a pickle of the original, or in an npz of the same five arrays.

    Raises:
        ValueError: the file is something else or too large, or its arrays don't fit together; the message gives file
            and cause. Nothing in it was executed.
    """
    try:
        data = read_bytes(path)
        return _checked(load_npz(data if data.startswith(b"PK\3\4") else _unpickled(data), Recording._fields))
    except MemoryError as error:
        raise InputError(f"{path}: reading it takes more memory than there is") from error
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error


def _unpickled(data: bytes) -> bytes:
    """Return the npz of the arrays in a pickle, made by the program `unpickle` in a process with limits."""
    command = [sys.executable, "-P", "-W", "ignore", str(UNPICKLE), *Recording._fields]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}  # each thread of NumPy would take memory below the limit
    try:
        done = subprocess.run(command, input=data, capture_output=True, timeout=LONGEST, env=environment)
    except subprocess.TimeoutExpired as error:
        raise InputError(f"not a pickle of numpy arrays: reading it takes more than {LONGEST} s") from error
    if done.returncode:
        cause = shortened(done.stderr.decode(errors="replace").strip()) if done.returncode == 1 else ""
        raise InputError(f"not a pickle of numpy arrays: {cause or 'it crashes the reader, or takes too long'}")
    return done.stdout


def _checked(arrays: dict[str, np.ndarray]) -> Recording:
    if not set(Recording._fields) <= set(arrays):
        raise InputError(f"a recording has the arrays {', '.join(Recording._fields)}")
    observations, actions, rewards, next_observations, terminals = (arrays[name] for name in Recording._fields)
    if sum(array.size for array in arrays.values()) * np.float32().itemsize > MAX_BYTES:
        raise InputError(f"its arrays take more than {MAX_BYTES >> 20} MiB in float32, the limit")
    matrices, rows = (observations, actions, next_observations), observations.shape[:1]
    fit = all(matrix.ndim == 2 and matrix.shape[:1] == rows and rows != (0,) for matrix in matrices)
    fit = fit and (rewards.size,) == (terminals.size,) == rows and observations.shape == next_observations.shape
    if not fit or observations.shape[1] % 2:
        shapes = {name: array.shape for name, array in arrays.items()}
        raise InputError(f"its arrays don't fit together: {shapes}")
    numbers = (observations, actions, rewards.reshape(-1), next_observations)
    with np.errstate(over="ignore"):  # too large values become infinite, which the next check finds
        recording = Recording(*[*(part.astype(np.float32) for part in numbers), terminals.reshape(-1).astype(bool)])
    if not all(np.isfinite(part).all() for part in recording) or not recording.terminals[-1]:
        raise InputError("it has values that are not finite, or stops in the middle of an episode")
    return recording
