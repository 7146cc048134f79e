"""Shared by the tests of sweeps: a grid whose two runs share a program, a scripted worker, and a host with fake GPUs."""

import os
import sys

import pytest

from earl_jax.sweeps import processes, slots

GRID = """
envs = ["tabletop_organization"]
algos = ["oracle"]
seeds = 2
steps = 120
eval_every = 40
eval_episodes = 2
checkpoint_every = 40
[options]
hidden_sizes = [[16]]
batch_size = 16
random_steps = 20
eval_horizon = 30
reward_scale = [1, 10]
"""
OPTIONS = "batch_size=16,eval_horizon=30,hidden_sizes=16,random_steps=20"
NAMES = [f"tabletop_organization/oracle/{OPTIONS},reward_scale={scale}" for scale in (1, 10)]
WORKER = """
import json, os, signal, sys, time
from pathlib import Path
from earl_jax.sweeps.processes import report
folder, groups, task = Path(FOLDER), GROUPS, json.loads(sys.stdin.readline())
if "grid" in task:
    runs = [{name: {"env": "sawyer_door"} for name in names} for names in groups]
    groups = [{"runs": named, "lanes": 1, "step": 0, "steps": 40, "replay_bytes": 0} for named in runs]
    report(plan={"out": task["out"], "imports": [], "finished": ["z"], "groups": groups})
    sys.exit()
name = list(task["runs"])[0]
emit = lambda state, detail="": report(run=name, state=state, detail=detail)
(folder / name).write_text(str(os.getpid()))
"""
MPS_CONTROL = """#!/bin/sh
folder=${CUDA_MPS_PIPE_DIRECTORY:-BIN/default}
pid_file="$folder/nvidia-cuda-mps-control.pid"
if [ "$1" = -d ]; then
  echo "start devices=$CUDA_VISIBLE_DEVICES" >> BIN/log
  if [ -e BIN/broken ]; then echo "MPS is not supported here" >&2; exit 1; fi
  sleep 600 &
  echo $! > "$pid_file"
  exit 0
fi
read command
if [ ! -e "$pid_file" ]; then echo "Cannot find MPS control daemon process"; exit 1; fi
if [ "$command" = quit ]; then
  echo quit >> BIN/log
  kill $(cat "$pid_file")
  rm "$pid_file"
fi
"""


@pytest.fixture
def grid(tmp_path):
    """The TOML file of `GRID`."""
    path = tmp_path / "grid.toml"
    path.write_text(GRID)
    return path


@pytest.fixture
def workers(tmp_path, monkeypatch):
    """A function that replaces the worker by a script, and returns a folder with the process id of each of its runs.

    Each of `groups` names the runs of a program; a further run, z, is finished before.
    """
    folder = tmp_path / "workers"
    folder.mkdir()

    def replace(body, groups="abcd"):
        script = tmp_path / "worker.py"
        script.write_text(WORKER.replace("FOLDER", repr(str(folder))).replace("GROUPS", repr(list(groups))) + body)
        monkeypatch.setattr(processes, "WORKER", [sys.executable, str(script)])
        return folder

    return replace


def read_tables(out):
    """Return the bytes of every metrics.csv of the sweep at `out`."""
    return {path.relative_to(out): path.read_bytes() for path in out.glob("*/*/*/metrics.csv")}


def write_executable(path, text):
    path.write_text(text)
    path.chmod(0o755)


@pytest.fixture
def gpus(tmp_path, monkeypatch):
    """The programs of a host with two GPUs, eight cores, MPS and jax's CUDA plugin, all of them fakes.

    `log` has the starts and ends of the MPS daemon. With a file `broken` it does not start; in `default` is the user's.
    """
    folder = tmp_path / "bin"
    folder.mkdir()
    (folder / "log").touch()
    write_executable(folder / "nvidia-smi", '#!/bin/sh\nprintf "GPU 0: NVIDIA H200\\nGPU 1: NVIDIA H200\\n"\n')
    write_executable(folder / "nvidia-cuda-mps-control", MPS_CONTROL.replace("BIN", str(folder)))
    monkeypatch.setenv("PATH", f"{folder}:{os.environ['PATH']}")
    for name in ("CUDA_VISIBLE_DEVICES", "CUDA_MPS_PIPE_DIRECTORY", "JAX_PLATFORMS", slots.FRACTION):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(slots, "cuda_plugin", lambda: tmp_path)
    monkeypatch.setattr(slots, "own_cores", lambda: list(range(8)))
    return folder
