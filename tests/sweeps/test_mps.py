"""The MPS daemon: started once, stopped at every end, never if it is somebody else's."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from earl_jax.sweeps.mps import MpsError, mps


def test_the_daemon_lives_as_long_as_the_context(gpus, monkeypatch):
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "1")
    with mps() as variables:
        folders = [Path(variables[name]) for name in ("CUDA_MPS_PIPE_DIRECTORY", "CUDA_MPS_LOG_DIRECTORY")]
        assert all(folder.is_dir() for folder in folders)
        assert gpus.log == ["start devices="], "the daemon would number the visible GPUs anew"
    assert gpus.log == ["start devices=", "quit"]
    assert not folders[0].parent.exists()


@pytest.mark.parametrize("error", [KeyboardInterrupt, SystemExit, ValueError])
def test_the_daemon_ends_with_an_error(gpus, error):
    with pytest.raises(error), mps():
        raise error
    assert gpus.log[-1] == "quit"


def test_a_daemon_that_answers_is_used_and_left_running(gpus):
    gpus.run_daemon()
    with mps() as variables:
        assert variables == {}
    assert gpus.log == []


def test_a_daemon_that_does_not_start_gives_its_cause(gpus, monkeypatch, tmp_path):
    gpus.break_mps()
    with pytest.raises(MpsError, match="MPS is not supported here"), mps():
        pass
    monkeypatch.setenv("PATH", str(tmp_path / "empty"))
    with pytest.raises(MpsError, match="nvidia-cuda-mps-control is not installed"), mps():
        pass


def test_a_daemon_that_ignores_quit_is_ended_by_its_process_id(gpus, monkeypatch):
    monkeypatch.setattr("earl_jax.sweeps.mps.PATIENCE", 0.2)
    control = gpus.bin / "nvidia-cuda-mps-control"
    control.write_text(control.read_text().replace("kill $(cat", "true $(cat"))
    with mps() as variables:
        pid = int(Path(variables["CUDA_MPS_PIPE_DIRECTORY"], "nvidia-cuda-mps-control.pid").read_text())
        os.kill(pid, 0)
    deadline = time.monotonic() + 10
    while Path(f"/proc/{pid}/cmdline").exists() and Path(f"/proc/{pid}/cmdline").read_bytes():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_the_daemon_ends_after_the_kill_of_its_launcher(gpus):
    code = "import time; from earl_jax.sweeps.mps import mps\nwith mps() as v: print(v, flush=True); time.sleep(60)"
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    folder = Path(eval(process.stdout.readline())["CUDA_MPS_PIPE_DIRECTORY"]).parent
    process.send_signal(signal.SIGKILL)
    process.communicate()
    deadline = time.monotonic() + 10
    while gpus.log[-1] != "quit" or folder.exists():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_a_daemon_that_never_runs_is_no_mps(gpus, monkeypatch):
    monkeypatch.setattr("earl_jax.sweeps.mps.PATIENCE", 0.1)
    control = gpus.bin / "nvidia-cuda-mps-control"
    control.write_text('#!/bin/sh\n[ "$1" = -d ]\n')
    with pytest.raises(MpsError, match="does not answer"), mps():
        pass
