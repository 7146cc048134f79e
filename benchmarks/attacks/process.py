"""Commands in processes of their own, bounded in time and memory.

The harness has imported the package but has started no jax backend, so a fork of it runs a command at once, with its own limits,
signals and patches.
"""

import contextlib
import importlib
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NoReturn

from benchmarks.attacks.case import Outcome
from benchmarks.kills import children

SECONDS, MEMORY_MB = 90.0, 3000.0
"""The bounds of a command: seconds of the processor, which may include a compilation, and the memory that it holds at once."""
WAITING = 4
"""How many times as long a command may last, because the machine is busy or because it waits."""
ADDRESSES = 1 << 34
"""Bytes of addresses of each process, as a last bound. jax maps a few GB."""
POLL = 0.01


MODULES = (
    "orbax.checkpoint", "earl_jax.cli.main", "earl_jax.training.api", "earl_jax.training.evaluation", "earl_jax.report.plots",
    "earl_jax.report.tables", "earl_jax.report.html.writing", "earl_jax.demos.importer", "earl_jax.paper.reproduce", "plotly",
)  # fmt: skip


def preload() -> None:
    """Import what the commands use, so that forks need not."""
    for name in MODULES:
        importlib.import_module(name)


class Command:
    """A running command. `wait` returns its outcome, after killing it if it passes a bound."""

    def __init__(self, pid: int, texts: Sequence[Path]):
        self.pid, self._texts, self._began = pid, texts, time.monotonic()
        self._outcome: Outcome | None = None

    def send(self, number: int) -> None:
        """Send a signal to the command, without its children."""
        os.kill(self.pid, number)

    def wait(self, seconds: float = SECONDS, memory_mb: float = MEMORY_MB) -> Outcome:
        """Return the outcome. `limit` is set if the command was killed because it passed a bound."""
        if self._outcome is None:
            limit = ""
            while not (ended := os.wait4(self.pid, os.WNOHANG))[0]:
                lasted = time.monotonic() - self._began
                if not limit and (lasted > WAITING * seconds or _processor_seconds(self.pid) > seconds):
                    limit = f"still running after {lasted:.0f} s"
                elif not limit and sum(map(_resident_mb, descendants(self.pid))) > memory_mb:
                    limit = f"took more than {memory_mb:g} MB"
                if limit:
                    for process in descendants(self.pid):
                        with contextlib.suppress(ProcessLookupError):
                            os.kill(process, signal.SIGKILL)
                time.sleep(POLL)
            _, status, usage = ended
            out, err = (path.read_text(errors="replace") for path in self._texts)
            seconds, peak = time.monotonic() - self._began, usage.ru_maxrss / 1024
            self._outcome = Outcome(
                os.waitstatus_to_exitcode(status), out, err, round(seconds, 3), round(peak, 1), limit
            )
            for path in self._texts:
                path.unlink()
        return self._outcome


def _processor_seconds(pid: int) -> float:
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _resident_mb(pid: int) -> float:
    try:
        pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    except (OSError, IndexError):
        return 0.0
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def descendants(pid: int) -> list[int]:
    """Return `pid` and the processes that it and its children have started."""
    below = children(pid)
    return [pid, *(process for child in below for process in descendants(child))]


def _texts() -> list[Path]:
    """Return two new files for stdout and stderr."""
    paths = []
    for _ in range(2):
        descriptor, name = tempfile.mkstemp(prefix="attack-")
        os.close(descriptor)
        paths.append(Path(name))
    return paths


def forked(action: Callable[[], object], cwd: Path) -> Command:
    """Return the running call of `action` in a fork of this process, in the folder `cwd`."""
    texts = _texts()
    sys.stdout.flush()
    sys.stderr.flush()
    pid = os.fork()
    if pid:
        return Command(pid, texts)
    _run_and_exit(action, cwd, texts)


def _run_and_exit(action: Callable[[], object], cwd: Path, texts: Sequence[Path]) -> NoReturn:
    """Run `action` as the interpreter runs a script, and end this process with its exit code."""
    code = 1
    try:
        os.setsid()
        os.chdir(cwd)
        limited(resource.RLIMIT_AS, ADDRESSES)()
        for path, number in zip(texts, (1, 2), strict=True):
            os.dup2(os.open(path, os.O_WRONLY | os.O_APPEND), number)
        sys.stdout, sys.stderr = os.fdopen(1, "w", closefd=False), os.fdopen(2, "w", closefd=False)
        action()
        code = 0
    except SystemExit as error:
        code = error.code if isinstance(error.code, int) else 0 if error.code is None else 1
        if isinstance(error.code, str):
            print(error.code, file=sys.stderr)
    except KeyboardInterrupt:
        traceback.print_exc()
        code = 130
    except BaseException:
        traceback.print_exc()
    finally:
        try:
            sys.stdout.flush()
            sys.stderr.flush()
        finally:  # an error of a full disk must not lead to the ordinary exit, which removes the harness's own files
            os._exit(code)


def spawned(arguments: Sequence[str], cwd: Path, environment: dict[str, str]) -> Command:
    """Return the running `python ARGUMENTS` in a new interpreter, for what a fork cannot show: its start and its end."""
    texts = _texts()
    with texts[0].open("wb") as out, texts[1].open("wb") as err:
        process = subprocess.Popen(
            [sys.executable, *arguments], cwd=cwd, stdin=subprocess.DEVNULL, stdout=out, stderr=err,
            env={**os.environ, **environment}, start_new_session=True,
        )  # fmt: skip
    process.returncode = 0  # `Command` waits for it
    return Command(process.pid, texts)


def limited(kind: int, size: int) -> Callable[[], None]:
    """Return a function that limits this process: resource.RLIMIT_FSIZE, for instance, to `size`."""

    def limit() -> None:
        resource.setrlimit(kind, (size, resource.getrlimit(kind)[1]))

    return limit
