"""Files that stay valid after a kill, on a full disk and beside other processes. Links and pipes are never opened."""

import contextlib
import errno
import os
import re
import stat
import sys
import warnings
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, BinaryIO, Literal

from earl_jax.errors import InputError

LOCK, PART = ".lock", ".part"
WITHOUT_LOCKS = {errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOLCK}
"""Errors of file systems that have no locks."""


class RunWarning(UserWarning):
    """A warning about the files of a run, which commands print as one line."""


CALLED_THROUGH = {__name__.partition(".")[0], "contextlib"}
"""Top-level modules of the functions between a user's line and a warning."""
DEFAULT_FORMAT = warnings.formatwarning


def format_warning(message: Warning | str, category: type[Warning], *details: Any) -> str:
    """Return a `RunWarning` as one line without a source location, any other warning in Python's format."""
    if issubclass(category, RunWarning):
        return f"earl-jax: {message}\n"
    return DEFAULT_FORMAT(message, category, *details)


def warn(message: str) -> None:
    """Warn with a `RunWarning` whose location is the line that called this package, such as one of a notebook."""
    frame, level = sys._getframe(), 1
    while frame.f_back and frame.f_globals.get("__name__", "").partition(".")[0] in CALLED_THROUGH:
        frame, level = frame.f_back, level + 1
    warnings.warn(message, RunWarning, stacklevel=level)


def check_kind(path: Path, kind: int = stat.S_IFREG) -> None:
    """Raise an InputError if there is something else at `path` than what `kind` says, a regular file or a folder."""
    with contextlib.suppress(FileNotFoundError):
        if stat.S_IFMT(path.lstat().st_mode) != kind:
            wanted = "folder" if kind == stat.S_IFDIR else "regular file"
            raise InputError(f"{path} is a link or not a {wanted}; remove it")


def check_folder(path: Path) -> None:
    """Raise an InputError if `path` is or leads through a file, or is an address, such as gs://bucket/run, not a local folder."""
    if re.match("[a-z][a-z0-9]+:/", path.as_posix()):
        raise InputError(f"{path} is an address, but runs need a local folder; choose one, and copy it there later")
    for each in (path, *path.parents):
        if each.exists() and not each.is_dir():
            raise InputError(f"{each} exists, but is not a folder; choose another folder")


def require_suffix(path: Path, suffixes: Collection[str], noun: str) -> None:
    """Raise an InputError unless the name of `path` ends in one of `suffixes`, as those of the files of `noun` do."""
    if path.suffix not in suffixes:
        raise InputError(f"{path}: {noun} are written as {', '.join(suffixes)}")


def opened(path: Path, mode: Literal["rb", "wb", "ab"] = "rb") -> BinaryIO:
    """Return the open file at `path`; a ValueError if a link, a pipe or a folder is there."""
    check_kind(path)
    return open(path, mode, opener=_open_again)


def _open_again(path: str, flags: int) -> int:
    try:
        return os.open(path, flags, 0o666)
    except OSError as error:
        if error.errno != errno.ESTALE:
            raise
    return os.open(path, flags, 0o666)  # NFS says so if another host has just replaced the file


def read_bytes(path: Path, limit: int) -> bytes:
    """Return the content of the regular file at `path`. Errors as `opened`, or it has more than `limit` bytes."""
    with opened(path) as handle:
        if os.fstat(handle.fileno()).st_size > limit:
            raise InputError(f"{path} is larger than {limit >> 20} MiB, the limit")
        return handle.read()


def _write(path: Path, mode: Literal["wb", "ab"], content: str | bytes) -> None:
    with opened(path, mode) as handle:
        handle.write(content.encode() if isinstance(content, str) else content)
        handle.flush()
        os.fsync(handle.fileno())


def write_atomically(path: Path, content: str | bytes) -> None:
    """Write `content` to `path`; a kill or a full disk leaves either the old file or the new one.

    Raises:
        ValueError: a link or a special file is at `path`.
        OSError: the file could not be written; an older one is unchanged.
    """
    part = path.with_name(path.name + PART)
    check_kind(path)
    try:
        part.unlink(missing_ok=True)  # a kill left it, or it is a link
        _write(part, "wb", content)
        os.replace(part, path)
    except OSError as error:
        with contextlib.suppress(OSError):
            part.unlink()
        raise OSError(f"{path} can't be written: {error.strerror or error}") from error


def written(path: Path, content: str | bytes) -> Path:
    """Return `path` after `write_atomically` there, in a folder that is created if necessary."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OSError(f"{path} can't be written: {error.filename}: {error.strerror}") from error
    write_atomically(path, content)
    return path


def append(path: Path, content: str) -> None:
    """Append to the file at `path`, which is created if necessary. Errors as `opened`."""
    _write(path, "ab", content)


def make_folder(path: Path) -> None:
    """Create the folder at `path`, unless it exists. Errors as `check_kind`."""
    check_kind(path, stat.S_IFDIR)
    path.mkdir(parents=True, exist_ok=True)


@contextlib.contextmanager
def locked(path: Path) -> Iterator[None]:
    """Lock the folder at `path` for this process; the system releases the lock when the process ends for any reason.

    On a file system without locks there is a warning instead.

    Raises:
        ValueError: another process has locked it, or its lock is a link.
        OSError: the folder is not writable.
    """
    import fcntl  # Windows lacks it

    try:
        handle = opened(path / LOCK, "ab")
    except OSError as error:
        raise OSError(f"{path / LOCK} can't be written to: {error.strerror or error}") from error
    with handle:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(f"{path} is in use by another process; try again when that process has ended") from None
        except OSError as error:
            if error.errno not in WITHOUT_LOCKS:
                raise OSError(f"{path} can't be locked: {error.strerror or error}") from error
            warn(f"{path} is on a file system without locks: make sure that no other process writes to it")
        yield


def inside(folder: Path, name: str) -> Path:
    """Return `folder/name`, which need not exist; a ValueError if it is outside `folder`, or a link in it leads to itself."""
    path = folder / name
    try:
        is_outside = not path.resolve().is_relative_to(folder.resolve())
    except (RuntimeError, OSError) as error:  # before Python 3.13, a loop of links is a RuntimeError
        raise InputError(f"{path} is a link that leads to itself; remove it") from error
    if is_outside:
        raise InputError(f"{path} points outside {folder}")
    return path
