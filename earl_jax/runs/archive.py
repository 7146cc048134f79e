"""A checkpoint on the disk: a folder named by its step, with a file of arrays for each part of the train state.

The files are npz, which have a checksum of every array.
"""

import os
import shutil
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from earl_jax.errors import InputError
from earl_jax.runs.files import PART, opened

Arrays = dict[str, Any]
"""NumPy arrays by their names."""
FILE = "arrays.npz"


class DamagedError(InputError):
    """The checkpoint of a `step` is damaged, for a `cause`."""

    def __init__(self, folder: Path, step: int, cause: str):
        super().__init__(f"checkpoint {folder / f'{step:09d}'} is damaged: {cause}")


def first_line(error: Exception) -> str:
    """Return what `error` says, as one line without the file's name."""
    return (getattr(error, "strerror", None) or str(error).strip() or repr(error)).splitlines()[0]


def write(folder: Path, step: int, parts: Mapping[str, Arrays]) -> None:
    """Write the checkpoint of `step`, in place of an older one of that step. It gets its name when it is complete."""
    path = folder / f"{step:09d}"
    unfinished = path.with_name(path.name + PART)
    try:
        unfinished.mkdir()
        for name, arrays in parts.items():
            (unfinished / name).mkdir()
            with (unfinished / name / FILE).open("wb") as handle:
                np.savez(handle, **arrays, step=step)
                handle.flush()
                os.fsync(handle.fileno())
        if path.exists():
            shutil.rmtree(path)
        unfinished.rename(path)
    except Exception:
        shutil.rmtree(unfinished, ignore_errors=True)
        raise


def _arrays(path: Path, most: float) -> Arrays:
    """Return the arrays of the file at `path`, which has at most `most` bytes.

    Raises:
        ValueError: the file is missing, larger or compressed, or an array does not match its checksum.
    """
    try:
        with opened(path) as handle:
            if os.fstat(handle.fileno()).st_size > most:  # also of a list of members, which zipfile reads in one piece
                raise ValueError("it does not belong to this run: its arrays are larger")
            with zipfile.ZipFile(handle) as archive:
                members = archive.infolist()
                if any(info.compress_type != zipfile.ZIP_STORED for info in members):
                    raise ValueError("its arrays are compressed")
                return {info.filename.removesuffix(".npy"): _array(archive, info) for info in members}
    except Exception as error:  # damage makes zipfile and NumPy raise errors of many types
        raise ValueError(f"{path.parent.name}/{FILE} can't be read: {str(error) or repr(error)}") from error


def _array(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> np.ndarray:
    """Return an array; zipfile checks its checksum at the end of its bytes."""
    with archive.open(info) as member:
        array = np.lib.format.read_array(member, allow_pickle=False)
        if member.read(1):
            raise ValueError(f"{info.filename} has another size than its array")
    return array


def read(folder: Path, step: int, most: Mapping[str, float]) -> dict[str, Arrays]:
    """Return the parts of the checkpoint of `step` that `most` names, with the bytes that each can have at most.

    Raises:
        DamagedError: it cannot be read, is larger, does not match its checksums, or was written at another step.
    """
    path = folder / f"{step:09d}"
    try:
        parts = {name: _arrays(path / name / FILE, size) for name, size in most.items()}
        written = {int(part.pop("step")) for part in parts.values()}
        if written != {step}:
            raise InputError(f"it is of step {min(written)}")
    except Exception as error:  # a step that is missing or text makes NumPy and Python raise others
        raise DamagedError(folder, step, first_line(error)) from error
    return parts
