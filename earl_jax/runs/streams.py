"""Output streams that may fail: a closed stream, a full disk or a reader that goes away never ends a process's work."""

import contextlib
import io
import os
import sys
from collections.abc import Iterator
from typing import Any, TextIO


class LastingStream:
    """The text stream `stream`, or none, whose writes never fail: `failure` is the first error, and that text is lost."""

    def __init__(self, stream: TextIO | None):
        self.stream = open(os.devnull, "w") if stream is None else stream  # noqa: SIM115
        self.failure: Exception | None = None

    def write(self, text: str) -> int:
        """Return the length of `text`, which the stream has received unless it failed."""
        self._attempt(self.stream.write, text)
        return len(text)

    def flush(self) -> None:
        """Pass on what the stream holds back."""
        self._attempt(self.stream.flush)

    def _attempt(self, call: Any, *arguments: Any) -> None:
        try:
            call(*arguments)
        except (OSError, ValueError) as error:  # a ValueError of a stream that was closed
            self.failure = self.failure or error

    def isatty(self) -> bool:
        """Return whether the stream is a terminal, which a closed one is not."""
        try:
            return self.stream.isatty()
        except ValueError:
            return False

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)

    def drop_rest(self) -> None:
        """Let what a stream that failed still holds go nowhere, because Python writes it when the process ends."""
        self.flush()
        if self.failure:
            with contextlib.suppress(OSError, ValueError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), self.stream.fileno())


@contextlib.contextmanager
def lasting_streams() -> Iterator[LastingStream]:
    """A context with lasting stdout and stderr; it returns stdout, which writes lines at once and escapes some."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:  # another file would get the number of the closed stream, and its output
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace", line_buffering=True)
    out, err = LastingStream(sys.stdout), LastingStream(sys.stderr)
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            yield out
        finally:
            out.drop_rest()
            err.drop_rest()
