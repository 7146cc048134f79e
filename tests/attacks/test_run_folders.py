"""Taken names, damaged configs and tables, and special files in run folders: one line or the right result, no damage."""

import functools
import json
import os
import shutil
import signal

import pytest

from earl_jax.runs.checkpoint import newest
from tests.attacks.conftest import contents, one_line, refused
from tests.cli.process import run, training

SCRIPT = "<script>alert(1)</script>"
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
    before = contents(tmp_path), [(path.name, path.lstat().st_mode) for path in tmp_path.iterdir()]
    code, _, err = run(*training(tmp_path / "run", *overwrite))
    one_line(code, err)
    assert (contents(tmp_path), [(path.name, path.lstat().st_mode) for path in tmp_path.iterdir()]) == before


def edit(change):
    """Return a damage that replaces the lines of a table by `change(lines)`."""
    return lambda text: "".join(change(text.splitlines(keepends=True)))


def cell(row, column, value):
    """Return a damage that puts `value` into one cell."""

    def change(lines):
        cells = lines[row].rstrip("\n").split(",")
        cells[column] = value
        return [*lines[:row], ",".join(cells) + "\n", *lines[row + 1 :]]

    return edit(change)


TABLES = {
    "only a line end": lambda text: "\n",
    "all rows twice": edit(lambda lines: [*lines, *lines[1:]]),
    "the last row cut": lambda text: text[:-9],
    "a column missing": edit(lambda lines: [line.rpartition(",")[0] + "\n" for line in lines]),
    "a column more": edit(lambda lines: [line[:-1] + ",1\n" for line in lines]),
    "a row too long": edit(lambda lines: [lines[0], lines[1][:-1] + ",1,2,3\n", *lines[2:]]),
    "a seed that is no number": cell(1, 1, "x"),
    "a seed of a fraction": cell(1, 1, "0.5"),
    "another step": cell(1, 0, "41"),
    "a step of NaN": cell(1, 0, "nan"),
    "a negative step": cell(1, 0, "-40"),
    "a step of 5000 digits": cell(1, 0, "9" * 5000),
    "code in a cell": cell(2, 3, SCRIPT),
    "an open quote": cell(2, 3, '"'),
    "null bytes": lambda text: text.replace("0", "\0"),
    "bytes that are no text": lambda text: text.replace("0", "\udcff", 3),
}


DRAWN = ("a column missing", "a step of NaN", "code in a cell", "null bytes")
READ = [(name, command) for name in TABLES for command in ("table", "resume")]
READ += [(name, command) for name in DRAWN for command in ("plot", "report")]


@pytest.mark.parametrize(("name", "command"), READ)
def test_a_damaged_table_is_refused_or_read_and_never_changed(name, command, copy, tmp_path):
    table = copy / "metrics.csv"
    table.write_bytes(TABLES[name](table.read_text()).encode(errors="surrogateescape"))
    before, out = contents(copy), tmp_path / {"plot": "out.png", "report": "out.html"}.get(command, "out.md")
    code, _, err = run(command, "run", *(() if command == "resume" else ("--out", out)))
    assert contents(copy) == before or (command == "resume" and code == 0)
    if code:
        assert not out.exists()
        assert "Traceback" not in err
        assert code == 2
    elif command != "resume":
        assert out.stat().st_size > 0
        assert command != "report" or SCRIPT not in out.read_text()


def value(field, new):
    """Return a damage that sets a field of config.json."""
    return lambda text: json.dumps({**json.loads(text), field: new})


CONFIGS = {
    **{f"env {new!r}": value("env", new) for new in ("", "../x", "sawyer_door", "tabletop_organization\n")},
    **{f"algo {new!r}": value("algo", new) for new in ("", None, "../x")},
    **{f"env_class {new!r}": value("env_class", new) for new in ("os:system", "x", "a:b", "../x:y")},
    **{f"algo_class {new!r}": value("algo_class", new) for new in ("os:system", "a:b")},
    **{f"options {new}": value("options", new) for new in ({"x": 1}, {"sac": 1}, {"name": "x"}, {"hidden_sizes": [0]})},
    **{f"env_options {new}": value("env_options", new) for new in (None, {"x": 1}, {"train_horizon": 3_000_000_000})},
    **{f"seeds {new}": value("seeds", new) for new in ([], [0, 0], [-1], [0], {"0": 1}, "01")},
    **{f"steps {new}": value("steps", new) for new in (0, -120, None, 121, [120])},
    **{f"id {new!r}": value("id", new) for new in (1, "../../x")},
    "half": lambda text: text[: len(text) // 2],
    "a million brackets": lambda text: "[" * 10**6,
    "a byte order mark": lambda text: "\ufeff{}",
    "a key twice": lambda text: '{"steps": 1, "steps": 2}',
    "a comment": lambda text: "// x\n{}",
}  # fmt: skip


@pytest.mark.parametrize("name", CONFIGS)
def test_a_damaged_config_is_one_line_or_means_nothing_for_a_table(name, copy):
    file = copy / "config.json"
    file.write_text(CONFIGS[name](file.read_text()))
    before = contents(copy)
    code, _, err = run("table", "run")
    assert contents(copy) == before
    if code:
        refused(code, err)
    else:
        assert "Traceback" not in err


SPECIAL = {
    "a loop": lambda path, outside: path.symlink_to(path.name),
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


def only_config(folder):
    """Keep of a run what a crash before the first evaluation leaves."""
    for path in folder.iterdir():
        if path.name != "config.json":
            shutil.rmtree(path) if path.is_dir() else path.unlink()


def half_config(folder):
    text = (folder / "config.json").read_text()
    only_config(folder)
    (folder / "config.json").unlink()
    (folder / "config.json.part").write_text(text[: len(text) // 2])


def no_newest_checkpoint(folder):
    """Keep of a run what a kill between its second and its third checkpoint leaves."""
    shutil.rmtree(folder / "checkpoints" / f"{newest(folder / 'checkpoints'):09d}")
    (folder / "metrics.csv").write_text("".join((folder / "metrics.csv").read_text().splitlines(keepends=True)[:5]))


LEFT = {
    "only its config": (only_config, "train"),
    "only its config, then resume": (only_config, "resume"),
    "half of its config": (half_config, "train"),
    "no newest checkpoint": (no_newest_checkpoint, "resume"),
}


@pytest.mark.parametrize("name", LEFT)
def test_a_start_that_a_crash_left_ends_with_the_identical_table(name, copy, whole):
    leave, command = LEFT[name]
    leave(copy)
    code, _, err = run(*(training("run") if command == "train" else ("resume", "run")))
    assert code == 0, err
    assert (copy / "metrics.csv").read_bytes() == (whole / "metrics.csv").read_bytes()


LONG = "x" * 200
NAMES = ("run with spaces", "run\nnewline", "😀", "x" * 256, "/".join([LONG] * 25), "run\x1b[31m", "~", "$HOME", "*")


@pytest.mark.parametrize("name", NAMES, ids=functools.partial(ascii))
def test_a_folder_of_any_name_holds_the_run_or_is_refused(name, whole, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    try:
        shutil.copytree(whole, tmp_path / name)
    except OSError:
        code, _, err = run("table", name)
        refused(code, err)
    else:
        code, out, err = run("table", name)
        assert (code, err) == (0, "")
        assert "fbrl" in out


UNUSABLE = {
    "gs://bucket/run": "is an address, and runs are written to local folders",
    "\udcff/run": "can't hold checkpoints: 'utf-8' codec can't encode",
    "/".join([LONG] * 20): "can't hold checkpoints: File name too long; mend this, or choose another folder",
}


@pytest.mark.parametrize("name", UNUSABLE, ids=["an address", "no text", "too long"])
def test_a_folder_that_cannot_hold_checkpoints_is_refused_before_training(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, _, err = run(*training(name[: 4040 - len(str(tmp_path))]))
    one_line(code, err, UNUSABLE[name])
    assert not list(tmp_path.rglob("config.json"))
