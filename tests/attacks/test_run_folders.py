"""Taken names, damaged tables, and special files in run folders: one line or the right result, and no damage."""

import os
import signal

import pytest

from tests.attacks.conftest import contents, refused
from tests.cli.process import run, training

BLOCKED = {
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
    path = tmp_path / "run"
    BLOCKED[name](path)
    before = contents(tmp_path), path.lstat().st_mode
    code, _, err = run(*training(path, *overwrite))
    refused(code, err)
    assert (contents(tmp_path), path.lstat().st_mode) == before


SCRIPT = "<script>alert(1)</script>"
TABLES = {
    "the last row cut": lambda text: text[:-9],
    "a column more": lambda text: text.replace("\n", ",1\n"),
    "a seed of a fraction": lambda text: text.replace("\n40,1,", "\n40,0.5,"),
    "a step of NaN": lambda text: text.replace("\n40,", "\nnan,", 1),
    "a step of 5000 digits": lambda text: text.replace("\n40,", f"\n{'9' * 5000},", 1),
    "code in a cell": lambda text: f"{text[: text.rindex(',')]},{SCRIPT}\n",
    "an open quote": lambda text: text.replace("\n40,1,", '\n40,1,"'),
    "null bytes": lambda text: text.replace("0", "\0"),
    "bytes that are no text": lambda text: text.replace("0", "\udcff", 3),
}
READ = [(name, command) for name in TABLES for command in ("table", "resume")]


@pytest.mark.parametrize(("name", "command"), [*READ, ("code in a cell", "report")])
def test_a_damaged_table_is_refused_or_read_and_never_changed(name, command, copy, tmp_path):
    table = copy / "metrics.csv"
    table.write_bytes(TABLES[name](table.read_text()).encode(errors="surrogateescape"))
    before, out = contents(copy), tmp_path / ("out.html" if command == "report" else "out.md")
    code, _, err = run(command, "run", *(() if command == "resume" else ("--out", out)))
    assert contents(copy) == before or (command == "resume" and code == 0)
    assert "Traceback" not in err
    assert code in (0, 2)
    assert out.exists() == (code == 0 and command != "resume")
    assert not out.exists() or SCRIPT not in out.read_text()


SPECIAL = {
    "a link to a folder": lambda path, outside: path.symlink_to(outside),
    "a hard link": lambda path, outside: os.link(outside / "secret.txt", path),
    "a named pipe": lambda path, outside: os.mkfifo(path),
}


@pytest.mark.parametrize("command", [("resume", "run"), ("table", "run"), ("evaluate", "run", "--episodes", "1")])
@pytest.mark.parametrize("name", ["config.json", "metrics.csv"])
@pytest.mark.parametrize("kind", SPECIAL)
def test_a_special_file_in_the_place_of_another_is_refused(kind, name, command, copy, tmp_path):
    """`evaluate` needs no table, so it may go on; nothing waits, and nothing outside is changed."""
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "secret.txt").write_text("not yours\n")
    (copy / name).unlink()
    SPECIAL[kind](copy / name, outside)
    code, _, err = run(*command)
    assert {path.name: path.read_text() for path in outside.iterdir()} == {"secret.txt": "not yours\n"}
    if (command[0], name) != ("evaluate", "metrics.csv"):
        refused(code, err)
    assert "Traceback" not in err
