"""Files that stay valid after a kill, on a full disk and with other processes. Nothing is written through a link."""

import contextlib
import errno
import os
import shutil
import stat
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeVar

from earl_jax import arrays
from earl_jax.errors import InputError

T = TypeVar("T")
LOCK, PART = ".lock", ".part"
BUSY = ".nfs"
"""What the names start with that NFS gives to deleted files which another process still reads."""
WITHOUT_LOCKS = {errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOLCK}
"""Errors of file systems that have no locks."""
NOT_REGULAR = {errno.ELOOP, errno.EMLINK, errno.ENOTDIR, errno.EISDIR, errno.ENXIO}
"""Errors of opening a link or a special file, which depend on the system."""


_UNLOCKED: set[Path] = set()
"""Folders without locks that a warning has named."""


class RunWarning(UserWarning):
    """A warning about the files of a run, which commands print as one line."""


class DamagedWarning(RunWarning):
    """A file is damaged, and an older copy is used."""


class UnlockedWarning(RunWarning):
    """The file system has no locks, so that other processes are not kept from writing."""


def require_plain(path: Path, kind: int = stat.S_IFREG) -> bool:
    """Return whether `path` exists.

    Raises:
        ValueError: it is a link, or not what `kind` says, a regular file or a folder.
    """
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        return False
    if stat.S_ISLNK(mode):
        raise InputError(f"{path} is a link, and a run writes through none; remove it")
    if stat.S_IFMT(mode) != kind:
        raise InputError(f"{path} is not a {'folder' if kind == stat.S_IFDIR else 'regular file'}; remove it")
    return True


def _open_to_write(path: Path, flags: int) -> int:
    """Return the descriptor of the regular file at `path`. Errors as `require_plain`."""
    try:
        number = os.open(path, flags | os.O_NOFOLLOW | os.O_NONBLOCK, 0o666)  # a FIFO would block
    except OSError as error:
        if error.errno in NOT_REGULAR:
            require_plain(path)
        raise
    if not stat.S_ISREG(os.fstat(number).st_mode):
        os.close(number)
        raise InputError(f"{path} is not a regular file; remove it")
    return number


def _write(path: Path, flags: int, content: str | bytes) -> None:
    with os.fdopen(_open_to_write(path, os.O_WRONLY | os.O_CREAT | flags), "wb") as handle:
        if os.fstat(handle.fileno()).st_nlink > 1:
            raise InputError(f"{path} is also another file's name (a hard link); remove one of them")
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
    require_plain(path)
    try:
        if require_plain(part):
            os.unlink(part)  # a kill left it, or it is a second name of another file
        try:
            _write(part, os.O_EXCL | os.O_TRUNC, content)
            os.replace(part, path)
        except OSError:
            with contextlib.suppress(OSError):
                os.unlink(part)
            raise
    except OSError as error:
        raise OSError(f"{path} can't be written: {error.strerror or error}") from error


def append(path: Path, content: str) -> None:
    """Append to the file at `path`, which is created if necessary. Errors as `require_plain`."""
    _write(path, os.O_APPEND, content)


def make_folder(path: Path) -> None:
    """Create the folder at `path`, unless it exists. Errors as `require_plain`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if not require_plain(path, stat.S_IFDIR):
        path.mkdir(exist_ok=True)


def remove(path: Path) -> None:
    """Remove a file, a link itself, or a folder with everything in it."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink()


def entries(folder: Path) -> list[Path]:
    """Return the entries of `folder`, sorted, without those that NFS keeps for a while."""
    return sorted(entry for entry in folder.iterdir() if not entry.name.startswith(BUSY))


def read_again(read: Callable[[], T]) -> T:
    """Return `read()`, called twice if another host replaced the file meanwhile, which NFS reports as a stale handle."""
    try:
        return read()
    except OSError as error:
        if error.errno != errno.ESTALE:
            raise
    return read()


def read_bytes(path: Path, limit: int | None = None) -> bytes:
    """Return the content of `path`.

    Raises:
        ValueError: it is not a regular file, or has more than `limit` bytes.
    """
    try:
        return read_again(lambda: arrays.read_bytes(path, limit))
    except InputError as error:
        raise InputError(f"{path} is {error}") from error


@contextlib.contextmanager
def locked(path: Path) -> Iterator[None]:
    """Lock the folder at `path` for this process; the system releases the lock when the process ends for any reason.

    On a file system without locks there is a warning instead.

    Raises:
        ValueError: another process has locked it, or its lock is a link.
        OSError: the folder is not writable.
    """
    try:
        number = _open_to_write(path / LOCK, os.O_RDWR | os.O_CREAT)
    except OSError as error:
        raise OSError(f"{path} can't be written to: {error.strerror or error}") from error
    try:
        _lock(number, path)
        yield
    finally:
        os.close(number)


def _lock(number: int, path: Path) -> None:
    import fcntl  # Windows lacks it

    try:
        fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise InputError(f"{path} is in use by another process") from None
    except OSError as error:
        if error.errno not in WITHOUT_LOCKS:
            raise OSError(f"{path} can't be locked: {error.strerror or error}") from error
        if path not in _UNLOCKED:
            _UNLOCKED.add(path)
            message = f"{path} is on a file system without locks: make sure that no other process writes to it"
            warnings.warn(message, UnlockedWarning, stacklevel=4)


def inside(folder: Path, name: str) -> Path:
    """Return `folder/name`, which need not exist.

    Raises:
        ValueError: the path is outside `folder`, or a link in it leads to itself.
    """
    path = folder / name
    try:
        is_outside = not path.resolve().is_relative_to(folder.resolve())
    except (RuntimeError, OSError) as error:  # before Python 3.13, a loop of links is a RuntimeError
        raise InputError(f"{path} is a link that leads to itself; remove it") from error
    if is_outside:
        raise InputError(f"{path} points outside {folder}")
    return path
