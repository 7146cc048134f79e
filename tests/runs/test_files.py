"""Files survive kills, full disks and other processes."""

import errno
import fcntl
import io
import os
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

from earl_jax.runs.files import UnlockedWarning, append, entries, inside, locked, read_bytes, write_atomically

HOLD_LOCK = (
    "import sys, time; from pathlib import Path; from earl_jax.runs.files import locked\n"
    "with locked(Path(sys.argv[1])): print('held', flush=True); time.sleep(60)"
)


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
    monkeypatch.setattr(os, "fsync", lambda number: (_ for _ in ()).throw(OSError(28, "No space left on device")))
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


def link_to(victim, path):
    victim.write_text("mine")
    path.symlink_to(victim)


def hard_link_to(victim, path):
    victim.write_text("mine")
    path.hardlink_to(victim)


@pytest.mark.parametrize("name", ["config.json", "config.json.part"])
def test_a_link_is_not_written_through(tmp_path, name):
    link_to(tmp_path / "victim", tmp_path / name)
    with pytest.raises(ValueError, match=f"{name} is a link"):
        write_atomically(tmp_path / "config.json", "new")
    assert (tmp_path / "victim").read_text() == "mine"


def test_an_unfinished_file_with_a_second_name_is_replaced(tmp_path):
    hard_link_to(tmp_path / "victim", tmp_path / "config.json.part")
    write_atomically(tmp_path / "config.json", "new")
    assert (tmp_path / "victim").read_text() == "mine"
    assert (tmp_path / "config.json").read_text() == "new"


@pytest.mark.parametrize(("make", "message"), [(link_to, "is a link"), (hard_link_to, "a hard link")])
def test_nothing_is_appended_to_a_file_with_another_name(tmp_path, make, message):
    make(tmp_path / "victim", tmp_path / "metrics.csv")
    with pytest.raises(ValueError, match=message):
        append(tmp_path / "metrics.csv", "new")
    assert (tmp_path / "victim").read_text() == "mine"


def test_a_fifo_is_refused_instead_of_waiting_for_its_other_end(tmp_path):
    os.mkfifo(tmp_path / "metrics.csv")
    with pytest.raises(ValueError, match="not a regular file"):
        append(tmp_path / "metrics.csv", "new")
    with pytest.raises(ValueError, match="not a regular file"):
        read_bytes(tmp_path / "metrics.csv")


@pytest.mark.parametrize("code", ["ENOSYS", "ENOTSUP", "EOPNOTSUPP", "ENOLCK"])
def test_a_file_system_without_locks_is_used_with_a_warning(tmp_path, monkeypatch, code):
    monkeypatch.setattr(fcntl, "flock", lambda *_: (_ for _ in ()).throw(OSError(getattr(errno, code), code)))
    with pytest.warns(UnlockedWarning, match=f"{tmp_path} is on a file system without locks"), locked(tmp_path):
        write_atomically(tmp_path / "config.json", "new")
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # the folder is named once
        with locked(tmp_path):
            pass


def test_another_error_of_a_lock_is_no_permission_to_write(tmp_path, monkeypatch):
    monkeypatch.setattr(fcntl, "flock", lambda *_: (_ for _ in ()).throw(OSError(errno.EIO, "Input/output error")))
    with pytest.raises(OSError, match="can't be locked: Input/output error"), locked(tmp_path):
        pass


def test_a_file_system_that_ignores_exclusive_creation_still_gets_whole_files(tmp_path, monkeypatch):
    real_open, real_unlink = os.open, os.unlink
    monkeypatch.setattr(
        os, "open", lambda path, flags, *rest, **named: real_open(path, flags & ~os.O_EXCL, *rest, **named)
    )
    monkeypatch.setattr(
        os, "unlink", lambda path, **named: None if path.name.endswith(".part") else real_unlink(path, **named)
    )
    (tmp_path / "config.json.part").write_text("a long text that another process left")
    write_atomically(tmp_path / "config.json", "new")
    assert (tmp_path / "config.json").read_text() == "new"


@pytest.mark.parametrize("failures", [1, 2])
def test_a_stale_handle_is_opened_again_once(tmp_path, monkeypatch, failures):
    (tmp_path / "metrics.csv").write_text("rows")
    real_open, left = io.open, [failures]

    def stale_open(*arguments, **named):
        if left[0]:
            left[0] -= 1
            raise OSError(errno.ESTALE, "Stale file handle", str(arguments[0]))
        return real_open(*arguments, **named)

    monkeypatch.setattr(io, "open", stale_open)
    if failures == 1:
        assert read_bytes(tmp_path / "metrics.csv") == b"rows"
    else:
        with pytest.raises(OSError, match=r"Stale file handle: '.*metrics\.csv'"):
            read_bytes(tmp_path / "metrics.csv")


def test_a_file_is_replaced_while_another_process_reads_it(tmp_path):
    path = tmp_path / "config.json"
    write_atomically(path, "old")
    with path.open() as reader:
        write_atomically(path, "new")
        assert reader.read() == "old"
    (tmp_path / ".nfs0001").write_text("old")
    assert entries(tmp_path) == [path]
