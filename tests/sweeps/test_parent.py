"""A worker ends at once when its launcher does, whatever it is doing."""

import os
import signal
import subprocess
import sys
import time

import pytest

BUSY = """
import re, sys
from earl_jax.sweeps.parent import end_with_pipe
end_with_pipe(0)
print("ready", flush=True)
re.match("(a*)*b", "a" * 40)  # takes years, and no other thread runs meanwhile
"""


@pytest.mark.skipif(sys.platform != "linux", reason="the system sends no SIGIO")
def test_code_that_holds_the_lock_ends_with_the_pipe():
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-c", BUSY], **pipes) as process:
        assert process.stdout.readline() == b"ready\n"
        time.sleep(0.1)
        process.stdin.close()
        assert process.wait(timeout=10) == -signal.SIGIO


@pytest.mark.parametrize("command", [["work"], ["plan", "nowhere.toml", "--out", "out"]])
def test_a_worker_ends_while_it_imports(command):
    process = subprocess.Popen(
        [sys.executable, "-m", "earl_jax.sweeps", *command, "--end-with-stdin"], stdin=subprocess.PIPE
    )
    began = time.monotonic()
    os.write(process.stdin.fileno(), b'{"out": "", "runs": {}}\n' if command == ["work"] else b"")
    time.sleep(0.5)
    process.stdin.close()
    assert process.wait(timeout=10) != 0
    assert time.monotonic() - began < 3, "importing takes longer"
