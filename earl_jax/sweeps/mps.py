"""NVIDIA's MPS daemon, which lets several processes compute on one GPU at the same time. No setting of a GPU is changed."""

import contextlib
import os
import shutil
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
GUARD = f"""
cat >/dev/null
pid=$(cat "$1/pipe/{CONTROL}.pid")
runs() {{ grep -q "^State:[[:space:]]*[^ZX[:space:]]" "/proc/$pid/status"; }}
echo quit | timeout {SECONDS} {CONTROL}
for tenth in $(seq "$2"); do runs || break; sleep 0.1; done
runs && kill "$pid"
rm -rf -- "$1"
"""
"""The shell commands that stop the daemon when their stdin, a pipe from the launcher, closes, also if that was killed."""


class MpsError(RuntimeError):
    """MPS cannot be used; the message gives the cause."""


@contextlib.contextmanager
def mps() -> Iterator[dict[str, str]]:
    """Yield the variables of programs that share a GPU through MPS, after starting the daemon; it ends with the context.

    If a daemon answers already, that one is used and left running. The daemon serves all GPUs: with CUDA_VISIBLE_DEVICES,
    it would number them anew for its clients.

    Raises:
        MpsError: MPS is not installed, or its daemon does not start.
    """
    if shutil.which(CONTROL) is None:
        raise MpsError(f"{CONTROL} is not installed")
    if _answers(os.environ):
        yield {}
        return
    folder = tempfile.mkdtemp(prefix="earl-mps-", dir="/tmp")  # names of sockets have to be short
    variables = {"CUDA_MPS_PIPE_DIRECTORY": f"{folder}/pipe", "CUDA_MPS_LOG_DIRECTORY": f"{folder}/log"}
    environment = {name: value for name, value in os.environ.items() if name != "CUDA_VISIBLE_DEVICES"} | variables
    guard = subprocess.Popen(
        ["/bin/sh", "-c", GUARD, "guard", folder, str(int(10 * PATIENCE))],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=environment,
        start_new_session=True,  # a terminal sends Ctrl-C to the launcher alone
    )
    assert guard.stdin is not None
    try:
        for path in variables.values():
            Path(path).mkdir()
        _start(environment, Path(folder, "pipe", f"{CONTROL}.pid"))
        yield variables
    finally:
        guard.stdin.close()
        with contextlib.suppress(subprocess.TimeoutExpired):  # it goes on by itself
            guard.wait(SECONDS + 2 * PATIENCE)


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
            if pid_file.exists() and Path("/proc", pid_file.read_text().strip()).exists():
                return
            raise MpsError(f"the daemon of {CONTROL} does not answer")
        time.sleep(0.1)


def _answers(environment: Mapping[str, str]) -> bool:
    """Return whether a daemon that programs with `environment` would use answers."""
    try:
        reply = subprocess.run(
            [CONTROL], input=b"get_server_list\n", capture_output=True, timeout=SECONDS, env=environment
        )
    except (OSError, subprocess.SubprocessError):
        return False
    return reply.returncode == 0 and b"Cannot find" not in reply.stdout + reply.stderr
