"""Files survive kills, full disks and other processes."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from earl_jax.runs.files import inside, locked, write_atomically

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


def test_a_lock_that_is_a_symbolic_link_is_not_followed(tmp_path):
    (tmp_path / "mine").write_text("all of it")
    (tmp_path / "run").mkdir()
    (tmp_path / "run/.lock").symlink_to(tmp_path / "mine")
    with pytest.raises(OSError, match="can't be written to"), locked(tmp_path / "run"):
        pass
    assert (tmp_path / "mine").read_text() == "all of it"


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
