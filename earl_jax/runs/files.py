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


class OpenFolder:
    """An open folder: files in it are reached relative to its `descriptor`, and links in it are refused.

    Names are those of direct entries. Every method raises an `InputError` that names the link or the special file if
    there is one at that name.
    """

    def __init__(self, path: Path, descriptor: int):
        self.path, self.descriptor = path, descriptor

    @contextlib.contextmanager
    def subfolder(self, name: str) -> Iterator["OpenFolder"]:
        """Open the folder `name`, after creating it if necessary."""
        with contextlib.suppress(FileExistsError):
            os.mkdir(name, dir_fd=self.descriptor)
        number = self.open(name, os.O_RDONLY | os.O_DIRECTORY)
        try:
            yield OpenFolder(self.path / name, number)
        finally:
            os.close(number)

    def open(self, name: str, flags: int) -> int:
        """Return the descriptor of the file or folder `name`."""
        kind = stat.S_IFDIR if flags & os.O_DIRECTORY else stat.S_IFREG
        try:
            flags |= os.O_NOFOLLOW | os.O_NONBLOCK  # a FIFO would block
            number = os.open(name, flags, 0o666, dir_fd=self.descriptor)
        except OSError as error:
            if error.errno in NOT_REGULAR:
                self.require(name, kind)
            raise
        if stat.S_IFMT(os.fstat(number).st_mode) != kind:
            os.close(number)
            self.require(name, kind)
        return number

    def require(self, name: str, kind: int = stat.S_IFREG) -> bool:
        """Return whether `name` exists; raise an InputError if it is anything but a file or folder, as `kind` says."""
        try:
            mode = os.stat(name, dir_fd=self.descriptor, follow_symlinks=False).st_mode
        except FileNotFoundError:
            return False
        if stat.S_ISLNK(mode):
            raise InputError(f"{self.path / name} is a link, and a run writes through none; remove it")
        if stat.S_IFMT(mode) != kind:
            wanted = "folder" if kind == stat.S_IFDIR else "regular file"
            raise InputError(f"{self.path / name} is not a {wanted}; remove it")
        return True

    def write(self, name: str, content: str | bytes) -> None:
        """Write the file `name`; a kill or a full disk leaves either the old file or the new one."""
        part = name + PART
        self.require(name)
        if self.require(part):
            os.unlink(part, dir_fd=self.descriptor)  # a kill left it, or it is a second name of another file
        try:
            self._write_through(part, os.O_CREAT | os.O_EXCL | os.O_TRUNC, content)
            os.replace(part, name, src_dir_fd=self.descriptor, dst_dir_fd=self.descriptor)
        except OSError:
            with contextlib.suppress(OSError):
                os.unlink(part, dir_fd=self.descriptor)
            raise

    def append(self, name: str, content: str) -> None:
        """Append to the file `name`, which is created if necessary."""
        self._write_through(name, os.O_CREAT | os.O_APPEND, content)

    def _write_through(self, name: str, flags: int, content: str | bytes) -> None:
        with os.fdopen(self.open(name, os.O_WRONLY | flags), "wb") as handle:
            if os.fstat(handle.fileno()).st_nlink > 1:
                raise InputError(f"{self.path / name} is also another file's name (a hard link); remove one of them")
            handle.write(content.encode() if isinstance(content, str) else content)
            handle.flush()
            os.fsync(handle.fileno())

    def names(self) -> list[str]:
        """Return the names of all entries, sorted, without those that NFS keeps for a while."""
        return sorted(name for name in os.listdir(self.descriptor) if not name.startswith(BUSY))

    def make(self, name: str) -> None:
        """Create the folder `name`, which must not exist, and check that its path leads to it."""
        os.mkdir(name, dir_fd=self.descriptor)
        created = os.stat(name, dir_fd=self.descriptor, follow_symlinks=False)
        if not os.path.samestat(created, (self.path / name).stat()):
            raise InputError(f"{self.path} was replaced by a link while it was written to")

    def remove(self, name: str) -> None:
        """Remove a file, a link itself, or a folder with everything in it."""
        mode = os.stat(name, dir_fd=self.descriptor, follow_symlinks=False).st_mode
        if stat.S_ISDIR(mode):
            shutil.rmtree(name, dir_fd=self.descriptor)
        else:
            os.unlink(name, dir_fd=self.descriptor)

    def rename(self, name: str, new_name: str) -> None:
        """Rename an entry."""
        os.rename(name, new_name, src_dir_fd=self.descriptor, dst_dir_fd=self.descriptor)


@contextlib.contextmanager
def opened(path: Path) -> Iterator[OpenFolder]:
    """Open the folder at `path`, which can be a link itself."""
    number = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        yield OpenFolder(path, number)
    finally:
        os.close(number)


def write_atomically(path: Path, content: str | bytes) -> None:
    """Write `content` to `path`; a kill or a full disk leaves either the old file or the new one.

    Raises:
        ValueError: a link or a special file is at `path`.
        OSError: the file could not be written; an older one is unchanged.
    """
    try:
        with opened(path.parent) as folder:
            folder.write(path.name, content)
    except OSError as error:
        raise OSError(f"{path} can't be written: {error.strerror or error}") from error


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
        with opened(path) as folder:
            number = folder.open(LOCK, os.O_RDWR | os.O_CREAT)
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
