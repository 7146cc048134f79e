"""A host with NVIDIA GPUs for tests: executables that act as nvidia-smi and as the control program of MPS."""

import os
import stat

MPS_CONTROL = """#!/bin/sh
folder=${{CUDA_MPS_PIPE_DIRECTORY:-{bin}/default}}
pid_file="$folder/nvidia-cuda-mps-control.pid"
if [ "$1" = -d ]; then
  echo "start devices=$CUDA_VISIBLE_DEVICES" >> {bin}/log
  if [ -e {bin}/broken ]; then echo "MPS is not supported here" >&2; exit 1; fi
  sleep 600 &
  echo $! > "$pid_file"
  exit 0
fi
read command
if [ ! -e "$pid_file" ]; then echo "Cannot find MPS control daemon process"; exit 1; fi
if [ "$command" = quit ]; then
  echo quit >> {bin}/log
  kill $(cat "$pid_file")
  rm "$pid_file"
fi
"""


class FakeGpus:
    """The folder `bin`, on PATH, of a host with `count` GPUs, and what its MPS daemon did."""

    def __init__(self, bin_, count):
        self.bin = bin_
        bin_.mkdir()
        lines = "".join(f"GPU {number}: NVIDIA H200 (UUID: GPU-{number})\\n" for number in range(count))
        write_executable(bin_ / "nvidia-smi", f'#!/bin/sh\nprintf "{lines}"\n')
        write_executable(bin_ / "nvidia-cuda-mps-control", MPS_CONTROL.format(bin=bin_))

    @property
    def log(self):
        """The starts and ends of the daemon, in order."""
        path = self.bin / "log"
        return path.read_text().splitlines() if path.exists() else []

    def break_mps(self):
        (self.bin / "broken").touch()

    def run_daemon(self):
        """Let the daemon of the user answer."""
        (self.bin / "default").mkdir()
        (self.bin / "default/nvidia-cuda-mps-control.pid").write_text("0")


def write_executable(path, text):
    path.write_text(text)
    path.chmod(path.stat().st_mode | stat.S_IXUSR)


def add_to_path(monkeypatch, folder):
    monkeypatch.setenv("PATH", f"{folder}:{os.environ['PATH']}")
