"""Taken names, folders that a crash left, and names of any kind: one line or the right result, no damage."""

import functools
import os
import shutil
import signal

import pytest

from tests.attacks.conftest import refused
from tests.cli.process import one_line, run, succeed, training, unchanged

BLOCKED = {
    "a folder with a thesis": lambda path: (path.mkdir(), (path / "thesis.tex").write_text("all of it")),
    "a folder with a hidden file": lambda path: (path.mkdir(), (path / ".git").write_text("x")),
    "a file": lambda path: path.write_text("x"),
    "a dangling link": lambda path: path.symlink_to("nowhere"),
    "a loop": lambda path: path.symlink_to(path.name),
    "a named pipe": os.mkfifo,
}


@pytest.fixture(autouse=True)
def _in_time():
    """End a command that waits for a pipe."""
    signal.alarm(60)
    yield
    signal.alarm(0)


@pytest.mark.parametrize("overwrite", [(), ("--overwrite",)], ids=["", "overwrite"])
@pytest.mark.parametrize("name", BLOCKED)
def test_a_taken_name_is_refused_and_left_as_it_is(name, overwrite, tmp_path):
    BLOCKED[name](tmp_path / "run")
    before = [(path.name, path.lstat().st_mode) for path in tmp_path.iterdir()]
    with unchanged(tmp_path, but=".lock"):
        one_line(run(*training(tmp_path / "run", *overwrite)))
    assert [(path.name, path.lstat().st_mode) for path in tmp_path.iterdir()] == before


@pytest.mark.parametrize("command", ["train", "resume"])
def test_a_start_that_a_crash_left_ends_with_the_identical_table(command, whole, tmp_path):
    """A crash before the first evaluation leaves a config, or half of one that is not in its place yet."""
    folder, text = tmp_path / "run", (whole / "config.json").read_text()
    folder.mkdir()
    if command == "train":
        (folder / "config.json.part").write_text(text[: len(text) // 2])
    else:
        (folder / "config.json").write_text(text)
    succeed(*(training(folder) if command == "train" else ("resume", folder)))
    assert (folder / "metrics.csv").read_bytes() == (whole / "metrics.csv").read_bytes()


LONG = "x" * 200
NAMES = (
    *("run with spaces", "run\nnewline", "😀", "x" * 256, "/".join([LONG] * 25)),
    *("run\x1b[31m", "./~", "$HOME", "*", "\udcff"),
)


@pytest.mark.parametrize("name", NAMES, ids=functools.partial(ascii))
def test_a_folder_of_any_name_holds_the_run_or_is_refused(name, whole, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    try:
        shutil.copytree(whole, tmp_path / name)
    except OSError:
        refused(run("table", name))
    else:
        code, out, err = run("table", name)
        assert (code, err) == (0, "")
        assert "fbrl" in out


UNUSABLE = {
    "gs://bucket/run": "is an address, but runs need a local folder",
    "/".join([LONG] * 20): "can't hold checkpoints: File name too long; mend this, or choose another folder",
}


@pytest.mark.parametrize("name", UNUSABLE, ids=["an address", "too long"])
def test_a_folder_that_cannot_hold_checkpoints_is_refused_before_training(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = name if "://" in name else f"{tmp_path}/{name}"[:4040]
    one_line(run(*training(path)), UNUSABLE[name])
    assert not list(tmp_path.rglob("config.json"))
