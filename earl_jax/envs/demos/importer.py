"""Import of demonstrations recorded for the original benchmark: untrusted pickles of numpy arrays, or npz files."""

import os
import subprocess
from pathlib import Path

import numpy as np

from earl_jax.assets import Demos, checked_demos
from earl_jax.errors import InputError, printable
from earl_jax.npz import MAX_BYTES, load_npz, read_bytes
from earl_jax.options.environment import PYTHON

UNPICKLE = Path(__file__).with_name("unpickle.py")
LONGEST = 180
"""Seconds after which the reading of a pickle is stopped, in case the system enforces no limit."""
FIELDS = ("observations", "actions", "rewards", "next_observations", "terminals")
"""The arrays of a recording: transitions of concatenated episodes, `terminals` true on the last one of each episode."""


def read(path: Path) -> Demos:
    """Return the demonstrations in a pickle of the original, or in an npz of the same five arrays.

    State and goal are the two halves of an observation.

    Raises:
        ValueError: the file is something else or too large, or its arrays don't fit together; the message gives file
            and cause. No code in the file was executed.
    """
    try:
        data = read_bytes(path)
        return _demos(load_npz(data if data.startswith(b"PK\3\4") else _unpickled(data), FIELDS))
    except MemoryError as error:
        raise InputError(f"{path}: reading the file takes more memory than is available") from error
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error


def _unpickled(data: bytes) -> bytes:
    """Return the npz of the arrays in a pickle, made by the program `unpickle` in a process with limits."""
    command = [*PYTHON, "-W", "ignore", str(UNPICKLE), *FIELDS]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}  # each thread of NumPy would take memory below the limit
    try:
        done = subprocess.run(command, input=data, capture_output=True, timeout=LONGEST, env=environment)
    except subprocess.TimeoutExpired as error:
        raise InputError(f"not a pickle of numpy arrays: reading it takes more than {LONGEST} s") from error
    if done.returncode:
        cause = printable(done.stderr.decode(errors="replace").strip()[:200]) if done.returncode == 1 else ""
        raise InputError(f"not a pickle of numpy arrays: {cause or 'it crashes the reader, or takes too long'}")
    return done.stdout


def _demos(arrays: dict[str, np.ndarray]) -> Demos:
    if not set(FIELDS) <= set(arrays):
        raise InputError(f"a recording must contain the arrays {', '.join(FIELDS)}")
    if sum(array.size for array in arrays.values()) * np.float32().itemsize > MAX_BYTES:
        raise InputError(f"its arrays exceed the limit of {MAX_BYTES >> 20} MiB in float32")
    halves = []
    for name in ("observations", "next_observations"):
        shape = arrays[name].shape
        if len(shape) != 2 or shape[1] % 2:
            raise InputError(f"{name} has the shape {shape}, not rows of a state and a goal of the same size")
        halves.append(np.split(arrays[name], 2, axis=1))
    (states, goals), (next_states, _) = halves
    rewards, ends = arrays["rewards"].reshape(-1), arrays["terminals"].reshape(-1)
    return checked_demos(Demos(states, goals, arrays["actions"], next_states, rewards, ends))
