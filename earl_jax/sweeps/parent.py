"""A process that ends with the one that started it."""

import os
import sys
import threading


def end_with_pipe(descriptor: int) -> None:
    """End this process as soon as the other end of the pipe `descriptor` closes, or anything is written to it.

    On Linux the system sends SIGIO, whose default action ends a process at once, even in code that holds Python's lock
    for long, such as that of a compiler. Elsewhere a thread waits.
    """
    if sys.platform == "linux":
        import fcntl

        fcntl.fcntl(descriptor, fcntl.F_SETOWN, os.getpid())
        fcntl.fcntl(descriptor, fcntl.F_SETFL, fcntl.fcntl(descriptor, fcntl.F_GETFL) | os.O_ASYNC)
    threading.Thread(target=_exit_when_closed, args=(descriptor,), daemon=True).start()  # also if it is closed already


def _exit_when_closed(descriptor: int) -> None:
    while os.read(descriptor, 1):
        pass
    os._exit(1)
