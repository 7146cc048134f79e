"""Disks that are full or read-only and clocks that jump, under a real process: it goes on or stops with one clear line."""

import contextlib
import json
import os
import shutil
import subprocess
import sys

import pytest

from earl_jax.runs.checkpoint import SPARE, newest
from tests.test_cli import ENVIRONMENT, run, snapshot, train

pytestmark = pytest.mark.slow
JUMPING = """
import itertools, sys, time
jumps, real = itertools.cycle([0, -86400, 3600, -1, 10**8]), time.time
time.time = lambda: real() + next(jumps)
time.perf_counter = lambda: 5.0
from earl_jax.cli import main
main(sys.argv[1:])
"""


@contextlib.contextmanager
def mounted(path, size):
    """Give a small disk of `size` at `path`."""
    path.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(path)]
    if shutil.which("mount") is None or subprocess.run(command, capture_output=True).returncode:
        pytest.skip("making a small disk takes the right to mount one")
    try:
        yield path
    finally:
        subprocess.run(["umount", str(path)], check=True)


def remount(path, options):
    subprocess.run(["mount", "-o", f"remount,{options}", str(path)], check=True)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "whole"
    code, _, err = run(*train(folder))
    assert code == 0, err
    return folder


def one_line(code, err):
    """Return the cause that a command ended with; rows of progress may stand before it."""
    assert code == 2, err
    assert "Traceback" not in err
    last = err.strip().splitlines()[-1]
    assert last.startswith("earl-jax: ")
    return last


def test_a_run_on_a_full_disk_stops_with_one_line_and_goes_on_when_there_is_room(whole, tmp_path):
    size = sum(file.stat().st_size for file in next((whole / "checkpoints").iterdir()).rglob("*") if file.is_file())
    with mounted(tmp_path / "disk", SPARE + 4 * size) as disk:
        code, _, err = run(*train(disk / "run"))
        assert "can't be written" in one_line(code, err)
        assert 0 < newest(disk / "run/checkpoints") < 400
        assert "can't be written" in one_line(*run("resume", disk / "run")[::2])
        remount(disk, "size=64m")
        code, _, err = run("resume", disk / "run")
        assert code == 0, err
        assert (disk / "run/metrics.csv").read_bytes() == (whole / "metrics.csv").read_bytes()


def test_a_full_disk_before_the_start_leaves_nothing_in_the_way(tmp_path):
    with mounted(tmp_path / "disk", "4k") as disk:
        (disk / "filler").write_bytes(b"x" * 4096)
        assert "No space left" in one_line(*run(*train(disk / "run"))[::2])
        remount(disk, "size=64m")
        code, _, err = run(*train(disk / "run"))
        assert code == 0, err


def test_a_read_only_folder_can_be_looked_at_and_nothing_else(whole, tmp_path):
    with mounted(tmp_path / "disk", "64m") as disk:
        shutil.copytree(whole, disk / "run")
        remount(disk, "ro")
        before = snapshot(disk)
        assert "can't be written" in one_line(*run("resume", disk / "run")[::2])
        assert "Read-only file system" in one_line(*run("resume", disk / "run", "--steps", "800")[::2])
        assert "Read-only file system" in one_line(*run(*train(disk / "other"))[::2])
        code, out, err = run("evaluate", disk / "run", "--episodes", "2", "--json")
        assert code == 0, err
        assert len(json.loads(out)["deployed/success"]) == 2
        assert snapshot(disk) == before


def test_a_clock_that_jumps_and_one_that_stands_still_change_nothing(whole, tmp_path):
    command = [sys.executable, "-c", JUMPING, *map(str, train(tmp_path / "run", "fbrl"))]
    found = subprocess.run(command, capture_output=True, text=True, env={**ENVIRONMENT, "PYTHONPATH": os.getcwd()})
    assert found.returncode == 0, found.stderr
    assert (tmp_path / "run/metrics.csv").read_bytes() == (whole / "metrics.csv").read_bytes()
