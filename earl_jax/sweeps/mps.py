"""NVIDIA's MPS daemon, which lets several processes compute on one GPU at the same time. No setting of a GPU is changed."""

import contextlib
import os
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator, Mapping
from pathlib import Path

CONTROL = "nvidia-cuda-mps-control"
SECONDS = 30
"""The longest time that a command to the daemon may take."""
PATIENCE = 5
"""Seconds that a daemon has to answer after its start, and to end after it was asked to."""
LONGEST_SOCKET = 60
"""Characters of a temporary folder in which the daemon's sockets have names of a valid length."""
GUARD = f'cat >/dev/null; echo quit | {CONTROL}; rm -rf -- "$1"'
"""The shell command that stops the daemon when its stdin, a pipe from the launcher, closes, also if that was killed."""


class MpsError(RuntimeError):
    """MPS cannot be used; the message gives the cause."""


@contextlib.contextmanager
def mps() -> Iterator[dict[str, str]]:
    """Yield the variables of programs that share a GPU through MPS, after starting the daemon; it ends with the context.

    If a daemon answers already, that one is used and left running.

    Raises:
        MpsError: MPS is not installed, or its daemon does not start.
    """
    if shutil.which(CONTROL) is None:
        raise MpsError(f"{CONTROL} is not installed")
    if _answers(os.environ):
        yield {}
        return
    parent = tempfile.gettempdir() if len(tempfile.gettempdir()) <= LONGEST_SOCKET else "/tmp"
    with tempfile.TemporaryDirectory(prefix="earl-mps-", dir=parent, ignore_cleanup_errors=True) as folder:
        variables = {"CUDA_MPS_PIPE_DIRECTORY": f"{folder}/pipe", "CUDA_MPS_LOG_DIRECTORY": f"{folder}/log"}
        for path in variables.values():
            Path(path).mkdir()
        with _daemon(folder, variables):
            yield variables


@contextlib.contextmanager
def _daemon(folder: str, variables: dict[str, str]) -> Iterator[None]:
    """Run the daemon for all GPUs: with CUDA_VISIBLE_DEVICES, it would number them anew for its clients."""
    environment = {name: value for name, value in os.environ.items() if name != "CUDA_VISIBLE_DEVICES"} | variables
    guard = subprocess.Popen(
        ["/bin/sh", "-c", GUARD, "guard", folder],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=environment,
        start_new_session=True,  # a terminal sends Ctrl-C to the launcher alone
    )
    pid_file = Path(variables["CUDA_MPS_PIPE_DIRECTORY"]) / f"{CONTROL}.pid"
    try:
        _start(environment, pid_file)
        yield
    finally:
        _stop(guard, pid_file)


def _start(environment: Mapping[str, str], pid_file: Path) -> None:
    """Start the daemon and wait until it answers, or at least until it had time to and its process runs."""
    with tempfile.TemporaryFile() as messages:  # a pipe would stay open as long as the daemon
        try:
            code = subprocess.run(
                [CONTROL, "-d"],
                stdin=subprocess.DEVNULL,
                stdout=messages,
                stderr=messages,
                timeout=SECONDS,
                env=environment,
                start_new_session=True,
            ).returncode
        except (OSError, subprocess.SubprocessError) as error:
            raise MpsError(str(error)) from error
        messages.seek(0)
        lines = messages.read().decode(errors="replace").strip().splitlines()
    if code:
        raise MpsError(lines[-1] if lines else f"{CONTROL} -d ended with code {code}")
    deadline = time.monotonic() + PATIENCE
    while not _answers(environment):
        if time.monotonic() > deadline:
            pid = _read_pid(pid_file)
            if pid is not None and _is_alive(pid):
                return
            raise MpsError(f"the daemon of {CONTROL} does not answer")
        time.sleep(0.1)


def _answers(environment: Mapping[str, str]) -> bool:
    """Return whether a daemon that programs with `environment` would use answers."""
    try:
        reply = subprocess.run(
            [CONTROL], input=b"get_server_list\n", capture_output=True, timeout=SECONDS, env=dict(environment)
        )
    except (OSError, subprocess.SubprocessError):
        return False
    return reply.returncode == 0 and b"Cannot find" not in reply.stdout + reply.stderr


def _stop(guard: subprocess.Popen[bytes], pid_file: Path) -> None:
    """Let `guard` stop the daemon; end it by its process id if it is still there after that."""
    pid = _read_pid(pid_file)
    assert guard.stdin is not None
    guard.stdin.close()
    try:
        guard.wait(SECONDS)
    except subprocess.TimeoutExpired:
        guard.kill()
        guard.wait()
    deadline = time.monotonic() + PATIENCE
    while pid and _is_alive(pid) and time.monotonic() < deadline:
        time.sleep(0.05)
    if pid and _is_alive(pid):
        with contextlib.suppress(OSError):
            os.kill(pid, signal.SIGTERM)


def _read_pid(path: Path) -> int | None:
    try:
        return int(path.read_text())
    except (OSError, ValueError):
        return None


def _is_alive(pid: int) -> bool:
    """Return whether the process `pid` runs; one that has ended may still wait for its parent."""
    try:
        os.kill(pid, 0)
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
