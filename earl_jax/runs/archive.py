"""The checkpoints in a folder on the disk: Orbax names, commits and removes them, and their arrays are npz files.

Orbax's own handler of arrays returns changed values for some flipped bits, and prints tracebacks of its threads for
others; an npz has a checksum of every array.
"""

import contextlib
import dataclasses
import logging
import math
import os
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np
import orbax.checkpoint as ocp

from earl_jax.errors import InputError
from earl_jax.runs.files import opened

Arrays = dict[str, Any]
"""NumPy arrays by their names."""
FILE, STEP = "arrays.npz", "step"


class DamagedError(InputError):
    """The checkpoint of a `step` is damaged, for a `cause`."""

    def __init__(self, folder: Path, step: int, cause: str):
        super().__init__(f"checkpoint {folder / f'{step:09d}'} is damaged: {cause}")


def first_line(error: Exception) -> str:
    """Return what `error` says, as one line without the file's name."""
    return (getattr(error, "strerror", None) or str(error).strip() or repr(error)).splitlines()[0]


class NpzHandler(ocp.CheckpointHandler):
    """Writes the arrays of one part of a checkpoint."""

    def save(self, directory: os.PathLike, args: "SaveArrays") -> None:
        """Write the arrays to a file in `directory`; they are on the disk when this returns."""
        with Path(directory, FILE).open("wb") as handle:
            np.savez(handle, **args.arrays)
            handle.flush()
            os.fsync(handle.fileno())

    def restore(self, directory: os.PathLike, *args: Any) -> Any:
        """Do nothing, because `read` reads the files by itself."""


@ocp.args.register_with_handler(NpzHandler, for_save=True, for_restore=True)  # Orbax saves none without both
@dataclasses.dataclass
class SaveArrays(ocp.args.CheckpointArgs):
    """The arrays that a part of a checkpoint receives."""

    arrays: Arrays


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
        np.lib.format.read_magic(member)
        shape, _, dtype = np.lib.format.read_array_header_1_0(member)
        if member.tell() + math.prod(shape) * dtype.itemsize != info.file_size:
            raise ValueError(f"{info.filename} has another size than its array")
    with archive.open(info) as member:  # a seek to the start would end the check of the checksum
        return np.lib.format.read_array(member, allow_pickle=False)


@contextlib.contextmanager
def _manager(folder: Path) -> Iterator[ocp.CheckpointManager]:
    """Yield Orbax's manager of the checkpoints in `folder`, for this host alone, without its log.

    It removes what a kill left. It saves synchronously: asynchronous saving aborts when the clock jumps.
    """
    host = jax.process_index()
    one_host = {"primary_host": host, "active_processes": {host}, "barrier_sync_key_prefix": f"host{host}"}
    options = ocp.CheckpointManagerOptions(
        max_to_keep=2,
        step_format_fixed_length=9,
        create=False,
        save_root_metadata=False,
        lightweight_initialize=True,
        enable_async_checkpointing=False,
        cleanup_tmp_directories=True,
        multiprocessing_options=ocp.options.MultiprocessingOptions(**(one_host if jax.process_count() > 1 else {})),
    )
    log = logging.getLogger("absl")
    level = log.level
    log.setLevel(logging.CRITICAL)
    try:
        with ocp.CheckpointManager(folder.resolve(), options=options) as manager:
            yield manager
    finally:
        log.setLevel(level)


def write(folder: Path, step: int, parts: dict[str, Arrays]) -> None:
    """Write the checkpoint of `step`, in place of an older one of that step, and keep the newest of the others.

    The first one in `folder` is read back.

    Raises:
        Exception: it could not be written; those of other steps are unchanged.
    """
    args = ocp.args.Composite(**{name: SaveArrays({**part, STEP: np.asarray(step)}) for name, part in parts.items()})
    with _manager(folder) as manager:
        older = manager.all_steps()
        if step in older:
            manager.delete(step)
        try:
            manager.save(step, args=args, force=True)
        except OSError:
            if step not in manager.all_steps():
                raise  # else an older one could not be removed: on NFS, files that another host reads stay
    if not older:
        read(folder, step, dict.fromkeys(parts, math.inf))


def read(folder: Path, step: int, most: Mapping[str, float]) -> dict[str, Arrays]:
    """Return the parts of the checkpoint of `step` that `most` names, with the bytes that each can have at most.

    Raises:
        DamagedError: it cannot be read, is larger, does not match its checksums, or was written at another step.
    """
    path = folder / f"{step:09d}"
    try:
        parts = {name: _arrays(path / name / FILE, size) for name, size in most.items()}
        written = {int(part.pop(STEP)) for part in parts.values()}
        if written != {step}:
            raise InputError(f"it is of step {min(written)}")
    except Exception as error:  # a step that is missing or text makes NumPy and Python raise others
        raise DamagedError(folder, step, first_line(error)) from error
    return parts
