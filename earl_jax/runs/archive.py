"""The checkpoints in a folder on the disk: Orbax names, commits and removes them, and their arrays are npz files.

Orbax's own handler of arrays returns changed values for some flipped bits, and prints tracebacks of its threads for
others; an npz has a checksum of every array.
"""

import contextlib
import dataclasses
import logging
import os
import zipfile
from collections.abc import Iterator, Sequence
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
KEPT = 2


class DamagedError(InputError):
    """The checkpoint of a `step` is damaged, for a `cause`."""

    def __init__(self, folder: Path, step: int, cause: str):
        super().__init__(f"checkpoint {folder / f'{step:09d}'} is damaged: {cause}")


def first_line(error: Exception) -> str:
    """Return what `error` says, as one line."""
    return (str(error).strip() or repr(error)).splitlines()[0]


class NpzHandler(ocp.CheckpointHandler):
    """Writes and reads the arrays of one part of a checkpoint."""

    def save(self, directory: os.PathLike, args: "SaveArrays") -> None:
        """Write the arrays to a file in `directory`; they are on the disk when this returns."""
        with Path(directory, FILE).open("wb") as handle:
            np.savez(handle, **args.arrays)
            handle.flush()
            os.fsync(handle.fileno())

    def restore(self, directory: os.PathLike, args: "ReadArrays") -> Arrays:
        """Return the arrays of the file in `directory`, which can take no more memory than the file has bytes.

        Raises:
            ValueError: the file is missing, or an array does not match its checksum.
        """
        del args
        path = Path(directory, FILE)
        try:
            with opened(path) as handle, zipfile.ZipFile(handle) as archive:
                members = archive.infolist()
                if sum(info.file_size for info in members) > os.fstat(handle.fileno()).st_size:
                    raise ValueError("its arrays are larger than the file")
                return {info.filename.removesuffix(".npy"): _array(archive, info) for info in members}
        except Exception as error:  # damage makes zipfile and NumPy raise errors of many types
            raise ValueError(f"{path.parent.name}/{FILE} can't be read: {error or repr(error)}") from error


@ocp.args.register_with_handler(NpzHandler, for_save=True)
@dataclasses.dataclass
class SaveArrays(ocp.args.CheckpointArgs):
    """The arrays that a part of a checkpoint receives."""

    arrays: Arrays


@ocp.args.register_with_handler(NpzHandler, for_restore=True)
@dataclasses.dataclass
class ReadArrays(ocp.args.CheckpointArgs):
    """The request for all arrays of a part of a checkpoint."""


def _array(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> np.ndarray:
    """Return an array; zipfile checks its checksum at the end of its bytes."""
    with archive.open(info) as member:
        array = np.lib.format.read_array(member, allow_pickle=False)
        if member.read(1):
            raise ValueError(f"{info.filename} is longer than its array")
    return array


@contextlib.contextmanager
def _manager(folder: Path, clean_up: bool = False) -> Iterator[ocp.CheckpointManager]:
    """Yield Orbax's manager of the checkpoints in `folder`, for this host alone, without its log.

    With `clean_up` it removes what a kill left. It saves synchronously: asynchronous saving aborts when the clock jumps.
    """
    host = jax.process_index()
    one_host = {"primary_host": host, "active_processes": {host}, "barrier_sync_key_prefix": f"host{host}"}
    options = ocp.CheckpointManagerOptions(
        max_to_keep=KEPT,
        step_format_fixed_length=9,
        create=False,
        save_root_metadata=False,
        lightweight_initialize=True,
        enable_async_checkpointing=False,
        cleanup_tmp_directories=clean_up,
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

    Raises:
        Exception: it could not be written; those of other steps are unchanged.
    """
    args = ocp.args.Composite(**{name: SaveArrays({**part, STEP: np.asarray(step)}) for name, part in parts.items()})
    with _manager(folder, clean_up=True) as manager:
        if step in manager.all_steps():
            manager.delete(step)
        try:
            manager.save(step, args=args, force=True)
        except OSError:
            if step not in manager.all_steps():
                raise  # else an older one could not be removed: on NFS, files that another host reads stay


def read(folder: Path, step: int, names: Sequence[str]) -> dict[str, Arrays]:
    """Return the parts `names` of the checkpoint of `step`.

    Raises:
        DamagedError: it cannot be read, does not match its checksums, or was written at another step.
    """
    try:
        with _manager(folder) as manager:
            restored = manager.restore(step, args=ocp.args.Composite(**{name: ReadArrays() for name in names}))
        parts = {name: restored[name] for name in names}
        written = {int(part.pop(STEP)) for part in parts.values()}
        if written != {step}:
            raise InputError(f"it is of step {min(written)}")
    except Exception as error:  # Orbax raises various exceptions if files are missing
        raise DamagedError(folder, step, first_line(error)) from error
    return parts
