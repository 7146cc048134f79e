"""The MPS daemon: started once, stopped at every end, never if it is somebody else's."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from earl_jax.sweeps.mps import MpsError, mps
from tests.cli.process import wait_until


def test_the_daemon_serves_all_gpus_and_ends_with_the_context(gpus, monkeypatch):
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "1")
    with mps() as variables:
        pipe, log = (Path(variables[name]) for name in ("CUDA_MPS_PIPE_DIRECTORY", "CUDA_MPS_LOG_DIRECTORY"))
        assert pipe.is_dir()
        assert log.is_dir()
        assert (gpus / "log").read_text() == "start devices=\n", "the daemon would number the visible GPUs anew"
    assert (gpus / "log").read_text().endswith("\nquit\n")
    assert not pipe.parent.exists()


@pytest.mark.parametrize(
    ("control", "message"),
    [('#!/bin/sh\n[ "$1" = -d ]\n', "does not answer"), (None, "nvidia-cuda-mps-control is not installed")],
)
def test_a_daemon_that_does_not_start_gives_its_cause(gpus, monkeypatch, tmp_path, control, message):
    monkeypatch.setattr("earl_jax.sweeps.mps.PATIENCE", 0.1)
    if control is None:
        monkeypatch.setenv("PATH", str(tmp_path / "empty"))
    else:
        (gpus / "nvidia-cuda-mps-control").write_text(control)
    with pytest.raises(MpsError, match=message), mps():
        pass


def test_a_daemon_that_ignores_quit_is_ended_by_its_process_id(gpus, monkeypatch):
    monkeypatch.setattr("earl_jax.sweeps.mps.PATIENCE", 1)
    control = gpus / "nvidia-cuda-mps-control"
    control.write_text(control.read_text().replace("kill $(cat", "true $(cat").replace('rm "$pid_file"', ""))
    with mps() as variables:
        pid = int(Path(variables["CUDA_MPS_PIPE_DIRECTORY"], "nvidia-cuda-mps-control.pid").read_text())
        command = Path(f"/proc/{pid}/cmdline")
        assert wait_until(command.read_bytes, 10)  # it is empty for a moment, until the daemon is loaded
    assert wait_until(lambda: not command.exists() or not command.read_bytes(), 10)


def test_the_daemon_ends_after_the_kill_of_its_launcher(gpus):
    code = "import time; from earl_jax.sweeps.mps import mps\nwith mps() as v: print(v, flush=True); time.sleep(60)"
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    folder = Path(eval(process.stdout.readline())["CUDA_MPS_PIPE_DIRECTORY"]).parent
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert wait_until(lambda: (gpus / "log").read_text().endswith("quit\n") and not folder.exists(), 10)
