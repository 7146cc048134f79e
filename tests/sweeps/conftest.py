"""Shared by the tests of sweeps: a grid of two runs that share one program."""

import pytest

from earl_jax.sweeps import per_device, slots
from tests.sweeps.fake_gpus import FakeGpus, add_to_path

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
LENGTHS = {"seeds": 2, "steps": 120, "eval_every": 40, "eval_episodes": 2, "checkpoint_every": 40}


@pytest.fixture
def grid(tmp_path):
    """The TOML file of `GRID`."""
    path = tmp_path / "grid.toml"
    path.write_text(GRID)
    return path


@pytest.fixture
def gpus(tmp_path, monkeypatch):
    """A host with two GPUs, eight cores and MPS, all of them fakes, and jax's CUDA plugin."""
    fake = FakeGpus(tmp_path / "bin", 2)
    add_to_path(monkeypatch, fake.bin)
    for name in ("CUDA_VISIBLE_DEVICES", "CUDA_MPS_PIPE_DIRECTORY", "JAX_PLATFORMS", slots.FRACTION):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(slots, "cuda_plugin", lambda: tmp_path)
    monkeypatch.setattr(per_device, "own_cores", lambda: list(range(8)))
    return fake
