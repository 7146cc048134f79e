"""Tests of how the command line reads numbers and seeds."""

import pytest

from earl_jax import __version__
from earl_jax.cli.parsing import join_seeds
from tests.cli.process import run


def test_a_list_of_seeds_ends_before_a_task():
    before = ["train", "--seeds", "3", "5:7", "8", "sawyer_door", "--steps", "10"]
    assert join_seeds(before) == ["train", "--seeds", "3,5:7,8", "sawyer_door", "--steps", "10"]
    assert join_seeds(["evaluate", "--seed", "3"]) == ["evaluate", "--seed", "3"]


def test_seed_suggests_seeds():
    code, _, err = run("train", "sawyer_door", "--seed", "3")
    assert code == 2
    assert err.splitlines()[-1].startswith("earl-jax: there is no option --seed: use --seeds")


def test_numbers_with_an_exponent_reach_the_command(tmp_path):
    code, _, err = run(
        "train", "tabletop_organization", "--steps", "1e3", "--eval-every", "3e2", "--out", tmp_path / "run"
    )
    assert code == 2
    assert "steps 1000 is not a multiple of eval_every 300" in err
    code, _, err = run("train", "tabletop_organization", "--steps", "1.5")
    assert code == 2
    assert "1.5" in err
    assert "1e6" in err


def test_version():
    assert run("--version") == (0, f"earl-jax {__version__}\n", "")


def test_seeds_that_are_none_are_refused():
    code, _, err = run("train", "tabletop_organization", "--seeds", "10:5")
    assert code == 2
    assert err.startswith("earl-jax: --seeds takes a count (5), a range (5:10, without 10) or a list")


def test_train_takes_a_list_of_seeds(monkeypatch, tmp_path):
    passed = {}
    monkeypatch.setattr("earl_jax.training.api.train", lambda *args, **options: passed.update(options) or 1 / 0)
    with pytest.raises(ZeroDivisionError):
        run("train", "--seeds", "3", "5", "8", "tabletop_organization", "--steps", "1e3", "--out", tmp_path / "run")
    assert passed["seeds"] == [3, 5, 8]
    assert passed["steps"] == 1000
