"""A folder that is moved while a process trains."""

import time

import pytest

from tests.cli.process import run, start, training


@pytest.mark.slow
def test_a_run_whose_folder_is_moved_ends_with_a_line_and_is_resumed_there(whole, tmp_path):
    folder, moved = tmp_path / "run", tmp_path / "moved"
    process = start(*training(folder))
    while not (folder / "metrics.csv").exists() and process.poll() is None:
        time.sleep(0.01)
    folder.rename(moved)
    _, err = process.communicate(timeout=300)
    assert process.returncode in (0, 2), err
    assert "Traceback" not in err
    code, _, err = run("resume", moved)
    assert code == 0, err
    assert (moved / "metrics.csv").read_bytes() == (whole / "metrics.csv").read_bytes()
