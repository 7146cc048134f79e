"""Tests of how the command line reads numbers and seeds."""

import pytest

from earl_jax import __version__
from earl_jax.cli.parsing import join_seeds, parse_seeds, parse_whole
from earl_jax.errors import InputError
from tests.cli.process import run


@pytest.mark.parametrize(
    ("text", "number"), [("1e6", 1_000_000), ("2_500_000", 2_500_000), ("2.50E6", 2_500_000), ("-3", -3), ("1e0", 1)]
)
def test_whole_numbers_can_have_an_exponent(text, number):
    assert parse_whole(text) == number
    assert isinstance(parse_whole(text), int)


@pytest.mark.parametrize("text", ["1.5", "2.55e1", "1e-3", "1e400", "1e19", "e6", "six", "", "nan", "1e", "9" * 5000])
def test_a_number_that_is_not_whole_or_too_large_is_refused(text):
    with pytest.raises(ValueError, match="whole number"):
        parse_whole(text)


@pytest.mark.parametrize(
    ("text", "seeds"), [("5", 5), ("5:10", [5, 6, 7, 8, 9]), ("3,5,8", [3, 5, 8]), ("1:3,8", [1, 2, 8]), ("4:5", [4])]
)
def test_seeds_are_a_count_a_range_or_a_list(text, seeds):
    parsed = parse_seeds(text)
    assert (parsed if isinstance(parsed, int) else list(parsed)) == seeds


@pytest.mark.parametrize("text", ["10:5", "5:5", "1:2:3", "a", "5:", ",", "", "0:99999999999,1"])
def test_other_seeds_are_refused(text):
    with pytest.raises(InputError, match="--seeds"):
        parse_seeds(text)


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


def test_train_takes_a_list_of_seeds(monkeypatch, tmp_path):
    passed = {}
    monkeypatch.setattr("earl_jax.training.api.train", lambda *args, **options: passed.update(options) or 1 / 0)
    with pytest.raises(ZeroDivisionError):
        run("train", "--seeds", "3", "5", "8", "tabletop_organization", "--steps", "1e3", "--out", tmp_path / "run")
    assert passed["seeds"] == [3, 5, 8]
    assert passed["steps"] == 1000
