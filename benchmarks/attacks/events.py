"""Acts at chosen accesses to files: a signal or an error at the n-th time that a process changes a folder."""

import errno
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path

CHANGES = {"open": 0, "os.rename": 0, "os.remove": 0, "os.mkdir": 0, "os.rmdir": 0, "os.truncate": 0, "os.link": 0}
WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT
Action = Callable[[], object]
NO_FILE = "<events>"


def unlisted(function: Callable[..., object]) -> Callable[..., object]:
    """Return `function` as code of no file: the package takes an error that passes through other files for one of a user's."""
    function.__code__ = function.__code__.replace(co_filename=NO_FILE)  # type: ignore[attr-defined]
    return function


def watch(folder: Path, act: Callable[[int], object]) -> None:
    """Call `act(n)` before the n-th change in `folder` by Python code of this process, from 1; it may raise an OSError.

    Relative names count too, because files may be opened relative to their folder.
    """
    count, root = [0], str(folder)

    def hook(event: str, arguments: tuple) -> None:
        if event not in CHANGES or not isinstance(arguments[0], str | bytes | os.PathLike):
            return
        if event == "open" and not (arguments[2] or 0) & WRITES:
            return
        path = os.fsdecode(arguments[0])
        if path.startswith(root) or not path.startswith("/"):
            count[0] += 1
            act(count[0])

    sys.addaudithook(unlisted(hook))


def signal_at(number: int, signum: int, folder: Path) -> Action:
    """Return a function that lets this process send itself `signum` before change `number` in `folder`."""

    def act(count: int) -> None:
        if count == number:
            os.kill(os.getpid(), signum)

    return lambda: watch(folder, act)


def fail_at(number: int, code: int, folder: Path, times: int = 1) -> Action:
    """Return a function that lets changes `number` to `number + times - 1` in `folder` raise an OSError."""

    def act(count: int) -> None:
        if number <= count < number + times:
            raise OSError(code, os.strerror(code))

    return lambda: watch(folder, unlisted(act))


def without_locks(code: int = errno.ENOSYS) -> Action:
    """Return a function after which locking a file raises an OSError, as on file systems without it."""

    def hook(event: str, arguments: tuple) -> None:
        if event in ("fcntl.flock", "fcntl.lockf"):
            raise OSError(code, os.strerror(code))

    return lambda: sys.addaudithook(unlisted(hook))


def hold_interrupts() -> None:
    """Give SIGINT its usual action, which a background process may have inherited as ignored."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
