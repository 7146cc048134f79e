"""The quickstart: what it promises, and the number that it prints. Its training is replaced by a written run."""

from pathlib import Path

import numpy as np
import pytest

from earl_jax import training
from earl_jax.cli import quickstart
from earl_jax.options.presets import PRESETS
from earl_jax.training import load
from tests.cli.process import succeed
from tests.report.run_files import TABLETOP, write_page_run


@pytest.fixture
def asked(monkeypatch):
    """The arguments of the training that the quickstart asks for."""
    arguments = {}

    def train(env, algo, out, **options):
        arguments.update(options, env=env, algo=algo)
        scores = np.arange(10, dtype=float)[None] * np.array([[0.1], [0.08]])
        write_page_run(out, algo, scores, env=env)
        return load(out)

    monkeypatch.setattr(training, "train", train)
    return arguments


def test_the_result_is_the_mean_of_the_last_evaluations_and_its_range_is_told(asked, tmp_path):
    out = succeed("quickstart", "--out", tmp_path)
    assert (asked["env"], asked["algo"]) == (TABLETOP, "fbrl")
    quick = PRESETS["quick"]
    assert (asked["seeds"], asked["steps"], asked["eval_every"]) == (2, quick.schedule.steps, quick.schedule.eval_every)
    score = np.arange(10)[-5:].mean() * 0.09
    assert f"deployed/success {score:.3f}, mean of 2 seeds over 5 evaluations, steps 60 to 100" in out
    table = (tmp_path / "table.md").read_text()
    assert f"| {score:.3f} |" in table
    low, high = quickstart.RANGE
    assert f"Expect a score of {low} to {high} after" in out


@pytest.mark.parametrize(("steps", "every"), [(15_000, 2500), (16_000, 16_000)])
def test_another_length_has_no_promise(asked, tmp_path, steps, every):
    out = succeed("quickstart", "--out", tmp_path, "--steps", steps, "--overwrite")
    assert "Expect" not in out
    assert f"50 episodes every {every:,} steps" in out
    assert (asked["steps"], asked["eval_every"], asked["overwrite"]) == (steps, every, True)


def test_the_pages_promise_what_the_command_does():
    root = Path(__file__).parents[2]
    low, high = quickstart.RANGE
    for page in ("README.md", "docs/getting_started.md"):
        assert f"Expect a score of {low} to {high}" in " ".join((root / page).read_text().split()), page
