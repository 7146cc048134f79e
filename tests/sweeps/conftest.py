"""Shared by the tests of sweeps: a grid of two methods that share one program."""

import pytest

GRID = """
envs = ["tabletop_organization"]
algos = ["naive", "oracle"]
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
"""
OPTIONS = "batch_size=16,eval_horizon=30,hidden_sizes=16,random_steps=20"
NAMES = [f"tabletop_organization/{algo}/{OPTIONS}" for algo in ("naive", "oracle")]
LENGTHS = {"seeds": 2, "steps": 120, "eval_every": 40, "eval_episodes": 2, "checkpoint_every": 40}


@pytest.fixture
def grid(tmp_path):
    """The TOML file of `GRID`."""
    path = tmp_path / "grid.toml"
    path.write_text(GRID)
    return path
