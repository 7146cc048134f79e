"""Files survive kills, full disks and other processes."""

import errno
import fcntl
import os
import subprocess
import sys
from pathlib import Path
from unittest.mock import DEFAULT, Mock

import pytest

from earl_jax import resume, train
from earl_jax.runs.files import RunWarning, append, inside, locked, read_bytes, write_atomically, written
from earl_jax.runs.folder import RunFolder
from tests.conftest import TINY, TINY_RUN

HOLD_LOCK = (
    "import sys, time; from pathlib import Path; from earl_jax.runs.files import locked\n"
    "with locked(Path(sys.argv[1])): print('held', flush=True); time.sleep(60)"
)


def test_a_warning_is_one_at_the_line_that_called_the_package(tmp_path):
    options = {**TINY, **TINY_RUN, "random_steps": 120, "steps": 120}
    with pytest.warns(RunWarning, match="nothing is learnt") as caught:
        train("tabletop_organization", "naive", out=tmp_path / "run", **options)
    RunFolder.open(tmp_path / "run").record(steps=160)
    with pytest.warns(RunWarning, match="now ends at step 120 instead of 160") as again:
        resume(tmp_path / "run", steps=120)
    assert {warning.filename for warning in [*caught, *again]} == {__file__}


def test_a_folder_is_locked_by_one_process_until_it_ends(tmp_path):
    owner = subprocess.Popen([sys.executable, "-c", HOLD_LOCK, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    assert owner.stdout.readline() == "held\n"
    with pytest.raises(ValueError, match=f"{tmp_path} is in use by another process"), locked(tmp_path):
        pass
    owner.kill()
    owner.communicate()
    with locked(tmp_path):
        assert (tmp_path / ".lock").exists()


def test_a_failed_write_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "config.json"
    write_atomically(path, "old")
    monkeypatch.setattr(os, "fsync", Mock(side_effect=OSError(errno.ENOSPC, "No space left on device")))
    with pytest.raises(OSError, match=r"config\.json can't be written: No space left on device"):
        write_atomically(path, "new")
    assert [file.name for file in tmp_path.iterdir()] == ["config.json"]
    assert path.read_text() == "old"


@pytest.mark.parametrize("name", ["..", "../other", "/etc/passwd", "a/../../b", "link/file"])
def test_a_path_that_leads_out_of_the_folder_is_refused(tmp_path, name):
    folder = tmp_path / "folder"
    folder.mkdir()
    (folder / "link").symlink_to(tmp_path)
    with pytest.raises(ValueError, match="points outside"):
        inside(folder, name)
    assert inside(folder, "a/../b") == Path(folder / "a/../b")


@pytest.mark.parametrize(
    ("name", "make"),
    [("a.csv.part", Path.symlink_to), ("a.csv.part", Path.hardlink_to), ("a.csv", Path.hardlink_to)],
)
def test_a_file_is_written_as_a_new_one_and_through_no_link(tmp_path, name, make):
    (tmp_path / "victim").write_text("mine")
    make(tmp_path / name, tmp_path / "victim")
    write_atomically(tmp_path / "a.csv", "new")
    assert (tmp_path / "a.csv").read_text() == "new"
    assert (tmp_path / "victim").read_text() == "mine"


SPECIAL = {
    "is a link": lambda path: path.symlink_to("victim"),
    "not a regular file": os.mkfifo,
    "is a link or not a regular file": Path.mkdir,
}


@pytest.mark.parametrize("kind", SPECIAL)
def test_a_file_that_is_another_or_a_pipe_is_not_opened(tmp_path, kind):
    (tmp_path / "victim").write_text("mine")
    path = tmp_path / "metrics.csv"
    SPECIAL[kind](path)
    for use in (lambda: append(path, "new"), lambda: write_atomically(path, "new"), lambda: read_bytes(path, 99)):
        with pytest.raises(ValueError, match=kind):
            use()
    assert (tmp_path / "victim").read_text() == "mine"


def test_a_file_in_the_place_of_a_folder_is_named(tmp_path):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(OSError, match=r"new\.csv can't be written: \S*/file: File exists"):
        written(tmp_path / "file" / "new.csv", "")
    assert written(tmp_path / "a" / "b", "new").read_text() == "new"


@pytest.mark.parametrize("code", ["ENOSYS", "ENOTSUP", "EOPNOTSUPP", "ENOLCK"])
def test_a_file_system_without_locks_is_used_with_a_warning(tmp_path, monkeypatch, code):
    monkeypatch.setattr(fcntl, "flock", Mock(side_effect=OSError(getattr(errno, code), code)))
    with pytest.warns(RunWarning, match=f"{tmp_path} is on a file system without locks"), locked(tmp_path):
        write_atomically(tmp_path / "config.json", "new")


def test_another_error_of_a_lock_is_no_permission_to_write(tmp_path, monkeypatch):
    monkeypatch.setattr(fcntl, "flock", Mock(side_effect=OSError(errno.EIO, "Input/output error")))
    with pytest.raises(OSError, match="can't be locked: Input/output error"), locked(tmp_path):
        pass


def test_a_stale_handle_is_opened_again_once(tmp_path, monkeypatch):
    path = tmp_path / "metrics.csv"
    path.write_text("rows")
    stale = OSError(errno.ESTALE, "Stale file handle", str(path))
    monkeypatch.setattr(os, "open", Mock(wraps=os.open, side_effect=[stale, DEFAULT, stale, stale]))
    assert read_bytes(path, 99) == b"rows"
    with pytest.raises(OSError, match=r"Stale file handle: '.*metrics\.csv'"):
        read_bytes(path, 99)
