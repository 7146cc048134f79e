"""A finished tiny run that the attacks damage, and what a command about it may say."""

import shutil

import pytest

from tests.cli.process import one_line, succeed, training


def refused(result):
    """Assert exit code 2 with one line, the parser's usage, or the cause of each run that a report leaves out."""
    code, _, err = result
    assert "Traceback" not in err
    if any(word in err for word in ("usage:", "helptext", "none of the runs can be used")):
        assert code == 2
    else:
        one_line(result)


@pytest.fixture(scope="session")
def whole(tmp_path_factory):
    """The folder of a finished run of fbrl, two seeds and 120 steps."""
    folder = tmp_path_factory.mktemp("attacks") / "whole"
    succeed(*training(folder))
    return folder


@pytest.fixture
def copy(whole, tmp_path, monkeypatch):
    """A copy of the finished run, `run` in the current folder."""
    monkeypatch.chdir(tmp_path)
    return shutil.copytree(whole, tmp_path / "run")
