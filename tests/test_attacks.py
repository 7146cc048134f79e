"""The fast cases of `python -m benchmarks.attacks`, each by `main` in this process."""

import os

import pytest

from benchmarks.attacks import place, runner
from benchmarks.attacks.case import Case, Outcome, refused
from benchmarks.attacks.catalogue import CLASSES, select
from benchmarks.attacks.place import Place
from tests.cli.process import run

CASES = select(fast=True)


def run_here(*arguments):
    """Return the outcome of a command that `main` runs in this process."""
    code, out, err = run(*arguments)
    return Outcome(code if isinstance(code, int) else 1, out, err)


@pytest.fixture(scope="module")
def baseline(tmp_path_factory):
    """The folder of the run that the cases copy."""
    folder = tmp_path_factory.mktemp("baseline")
    outcome = run_here(*place.train(folder / "whole"))
    assert outcome.code == 0, outcome.err
    return folder


@pytest.mark.parametrize(("kind", "case"), CASES, ids=[f"{kind}: {case.name}" for kind, case in CASES])
def test_a_case_is_survived(kind, case, baseline, tmp_path, monkeypatch):
    where = Place(tmp_path / "case", baseline, run_here)
    monkeypatch.chdir(where.path)
    row = runner.run_case(kind, case, where)
    monkeypatch.chdir(tmp_path)
    assert row["verdict"] == "survived", f"{row['how']}; expected: {case.expected}"


def test_the_names_of_cases_are_unique():
    for kind in CLASSES:
        names = [case.name for _, case in select([kind])]
        assert len(set(names)) == len(names), kind


@pytest.mark.parametrize(
    ("name", "attack", "reason"),
    [
        ("success instead of a refusal", lambda place: refused(place.run("list")), "exit code 0"),
        ("another cause", lambda place: refused(place.run("train", "nowhere"), "a minotaur"), "'a minotaur'"),
        ("an error of the case", lambda place: str(1 // 0), "ZeroDivisionError"),
        ("a file outside", lambda place: str((place.outside / "new.txt").write_text("")), "new.txt"),
    ],
)
def test_a_wrong_expectation_is_reported_as_failed(name, attack, reason, tmp_path):
    row = runner.run_case("self-test", Case(name, "to fail", attack), Place(tmp_path / "case", tmp_path, run_here))
    assert row["verdict"] == "failed"
    assert reason in row["how"]
    assert os.listdir(tmp_path) == []
