"""Files that stay valid after a kill, on a full disk, and with other processes."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from filelock import FileLock, Timeout

from earl_jax.errors import InputError

LOCK, PART = ".lock", ".part"


class DamagedWarning(UserWarning):
    """A file is damaged, and an older copy is used."""


def write_atomically(path: Path, content: str | bytes) -> None:
    """Write `content` to `path`; a kill or a full disk leaves either the old file or the new one."""
    part = path.with_name(path.name + PART)
    try:
        with part.open("wb") as handle:
            handle.write(content.encode() if isinstance(content, str) else content)
            handle.flush()
            os.fsync(handle.fileno())
        part.replace(path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise OSError(f"{path} can't be written: {error.strerror or error}") from error


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Lock `folder` for this process; the system releases the lock when the process ends for any reason.

    Raises:
        ValueError: another process has locked it.
        OSError: the folder is not writable.
    """
    lock = FileLock(folder / LOCK, blocking=False, fallback_to_soft=False)
    try:
        with contextlib.suppress(NotImplementedError):  # a file system without locks
            lock.acquire()
    except Timeout:
        raise InputError(f"{folder} is in use by another process") from None
    except OSError as error:
        raise OSError(f"{folder} can't be written to: {error.strerror or error}") from error
    try:
        yield
    finally:
        lock.release()


def inside(folder: Path, name: str) -> Path:
    """Return `folder/name`, which need not exist.

    Raises:
        ValueError: the path is outside `folder`.
    """
    path = folder / name
    if not path.resolve().is_relative_to(folder.resolve()):
        raise InputError(f"{path} points outside {folder}")
    return path
