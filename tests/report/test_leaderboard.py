"""The row of a run on the leaderboard."""

import numpy as np
import pytest

from earl_jax.metrics.deployed import WIDE
from earl_jax.report.leaderboard import run_row
from earl_jax.report.runs import read_methods
from tests.report.run_files import TABLETOP, write_run


def test_the_row_of_a_run_has_the_scores_of_its_last_100000_steps(tmp_path):
    scores = np.tile(np.linspace(0.0, 0.9, 10), (2, 1)) + np.array([[0.0], [0.1]])
    metrics = {"continuing/reward": 0.25, "continuing/recent": 0.25, "interventions": 1, WIDE: [[0.2], [0.4]]}
    steps = range(100_000, 1_100_000, 100_000)
    write_run(tmp_path, TABLETOP, "naive", scores, steps=steps, metrics=metrics)
    row = run_row(read_methods([tmp_path])[0], "0123456789abcdef", "mine")
    assert row.texts[:4] == ["naive", "mine", "2", "1.00M"]
    assert row.score == pytest.approx(0.95)
    assert row.deployed.startswith("0.950 [")
    assert row.wide.startswith("0.300 [")
    assert row.continuing.startswith("0.250")
    assert row.crossings[0].startswith("0.60M")
    assert row.commit == "012345678"
    assert run_row(read_methods([tmp_path])[0], "").commit == "-"
    assert run_row(read_methods([tmp_path])[0], "0123456789abcdef-dirty").commit == "012345678-dirty"
