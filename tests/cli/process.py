"""The command line, in this process or in its own, with a tiny training run on which several test files rely."""

import contextlib
import io
import os
import socket
import subprocess
import sys
import time
import warnings

from earl_jax import cli
from tests.conftest import CACHE, TESTS

TASK = "tabletop_organization"
TINY = ["--seeds", "2", "--steps", "120", "--eval-every", "40", "--eval-episodes", "2", "--checkpoint-every", "40"]
TINY_OPTIONS = ["--set", "hidden_sizes=[16]", "batch_size=16", "--set", "random_steps=20"]
ADDED = {
    "JAX_PLATFORMS": "cpu",
    "PYTHONUNBUFFERED": "",
    "JAX_COMPILATION_CACHE_DIR": str(CACHE),
    "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    "PYTHONPATH": os.pathsep.join(filter(None, [str(TESTS.parent), os.environ.get("PYTHONPATH")])),
}
"""Variables that let a process find the tests, share their compiled programs and buffer its output as a user's does."""
ENVIRONMENT = {**os.environ, **ADDED}


def free_port():
    with socket.socket() as listener:
        listener.bind(("localhost", 0))
        return listener.getsockname()[1]


def wait_until(condition, seconds=240):
    """Wait until `condition` holds, or for some seconds, and return whether it does."""
    deadline = time.monotonic() + seconds
    while not (holds := condition()) and time.monotonic() < deadline:
        time.sleep(0.01)
    return bool(holds)


def start(*arguments):
    """Return the running process of one command."""
    command = [sys.executable, "-m", "earl_jax.cli", *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=ENVIRONMENT)


def start_two(*arguments, minutes=("60", "60")):
    """Return the processes of one command on two hosts, each with its limit of `minutes`."""
    address = f"localhost:{free_port()}"
    return [start(*arguments, "--hosts", f"{address},2,{number}", "--minutes", minutes[number]) for number in range(2)]


def run_process(*arguments):
    """Return exit code, stdout and stderr of one command in its own process."""
    process = start(*arguments)
    out, err = process.communicate(timeout=300)
    return process.returncode, out, err


def run_code(code, *arguments, cwd=TESTS.parent, **variables):
    """Return what Python code prints in its own process, with more `variables`; it must end with code 0."""
    command = [sys.executable, "-c", code, *map(str, arguments)]
    env = ENVIRONMENT | variables
    result = subprocess.run(command, env=env, cwd=cwd, capture_output=True, text=True, timeout=570)
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout


def run(*arguments):
    """Return exit code, stdout and stderr of one command, run by `main` in this process."""
    out, err, format_warning = io.StringIO(), io.StringIO(), warnings.formatwarning
    code = 0
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            cli.main([str(argument) for argument in arguments])
    except SystemExit as exit_info:
        code = exit_info.code
    finally:
        warnings.formatwarning = format_warning
    return code, out.getvalue(), err.getvalue()


def succeed(*arguments, by=run):
    """Return what one command prints to stdout; `by` runs it, and it must end with code 0."""
    code, out, err = by(*arguments)
    assert code == 0, err
    return out


def one_line(result, *words):
    """Assert that the `result` of a command is exit code 2 and one readable line that has all `words`."""
    code, _, err = result
    lines = err.strip().splitlines()
    assert code == 2, (code, err[-500:])
    assert len(lines) == 1, err[-500:]
    assert lines[0].startswith("earl-jax: ")
    assert len(lines[0]) < 2000
    assert all(word in lines[0] for word in words), lines[0]


def training(folder, *others, task=TASK, algo="fbrl"):
    """Return the arguments of a run of 120 steps into `folder`, whose program all tests share."""
    return ["train", task, "--algo", algo, "--out", str(folder), *TINY, *others, *TINY_OPTIONS]


def snapshot(folder):
    """Return the bytes of every file below `folder`."""
    return {path: path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


@contextlib.contextmanager
def unchanged(folder, but=""):
    """A context that leaves every file below `folder` as it is, `but` one of that name."""
    before = snapshot(folder)
    yield
    after = snapshot(folder)
    assert [path for path in before | after if before.get(path) != after.get(path) and path.name != but] == []
