"""Full disks, read-only disks and clocks that jump, with a real process: it goes on, or ends with one clear line."""

import contextlib
import json
import os
import shutil
import subprocess
import sys

import pytest

from earl_jax.runs.checkpoint import newest
from tests.cli.process import ENVIRONMENT, run_process, snapshot, train

pytestmark = pytest.mark.slow
MAIN_WITH_A_JUMPING_CLOCK = """
import itertools, sys, time
jumps, real = itertools.cycle([0, -86400, 3600, -1, 10**8]), time.time
time.time = lambda: real() + next(jumps)
time.perf_counter = lambda: 5.0
from earl_jax.cli.main import main
main(sys.argv[1:])
"""


@contextlib.contextmanager
def mounted(path, size):
    """Mount a small disk of `size` at `path`."""
    path.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(path)]
    if shutil.which("mount") is None or subprocess.run(command, capture_output=True).returncode:
        pytest.skip("a small disk needs the right to mount one")
    try:
        yield path
    finally:
        subprocess.run(["umount", str(path)], check=True)


def remount(path, options):
    subprocess.run(["mount", "-o", f"remount,{options}", str(path)], check=True)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "whole"
    code, _, err = run_process(*train(folder))
    assert code == 0, err
    return folder


def error_line(code, err):
    """Return the error that a command ended with; rows of progress may stand before it."""
    assert code == 2, err
    assert "Traceback" not in err
    last = err.strip().splitlines()[-1]
    assert last.startswith("earl-jax: ")
    return last


def test_a_run_on_a_full_disk_stops_with_an_error_line_and_resumes_when_there_is_room(whole, tmp_path):
    size = sum(file.stat().st_size for file in next((whole / "checkpoints").iterdir()).rglob("*") if file.is_file())
    with mounted(tmp_path / "disk", 5 * size // 2 + (200 << 10)) as disk:
        code, _, err = run_process(*train(disk / "run"))
        assert "can't be written" in error_line(code, err)
        assert 0 < newest(disk / "run/checkpoints") < 400
        assert "can't be written" in error_line(*run_process("resume", disk / "run")[::2])
        remount(disk, "size=64m")
        code, _, err = run_process("resume", disk / "run")
        assert code == 0, err
        assert (disk / "run/metrics.csv").read_bytes() == (whole / "metrics.csv").read_bytes()


def test_a_full_disk_at_the_start_leaves_a_folder_that_can_be_used_later(tmp_path):
    with mounted(tmp_path / "disk", "4k") as disk:
        (disk / "filler").write_bytes(b"x" * 4096)
        assert "No space left" in error_line(*run_process(*train(disk / "run"))[::2])
        remount(disk, "size=64m")
        code, _, err = run_process(*train(disk / "run"))
        assert code == 0, err


def test_a_read_only_run_can_be_evaluated_and_is_not_changed(whole, tmp_path):
    with mounted(tmp_path / "disk", "64m") as disk:
        shutil.copytree(whole, disk / "run")
        remount(disk, "ro")
        before = snapshot(disk)
        assert "can't be written" in error_line(*run_process("resume", disk / "run")[::2])
        assert "Read-only file system" in error_line(*run_process("resume", disk / "run", "--steps", "800")[::2])
        assert "Read-only file system" in error_line(*run_process(*train(disk / "other"))[::2])
        code, out, err = run_process("evaluate", disk / "run", "--episodes", "2", "--json")
        assert code == 0, err
        assert len(json.loads(out)["deployed/success"]) == 2
        assert snapshot(disk) == before


def test_clocks_that_jump_or_stand_still_change_nothing(whole, tmp_path):
    command = [sys.executable, "-c", MAIN_WITH_A_JUMPING_CLOCK, *map(str, train(tmp_path / "run")), "--minutes", "60"]
    result = subprocess.run(command, capture_output=True, text=True, env={**ENVIRONMENT, "PYTHONPATH": os.getcwd()})
    assert result.returncode == 0, result.stderr
    assert (tmp_path / "run/metrics.csv").read_bytes() == (whole / "metrics.csv").read_bytes()
