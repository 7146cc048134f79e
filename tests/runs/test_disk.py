"""Full disks, folders of another user and clocks that jump, with a real process: it goes on, or ends with one clear line."""

import contextlib
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from earl_jax.runs.checkpoint import newest
from tests.cli.process import ENVIRONMENT, run_code, run_process, succeed, training, unchanged

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


def train(folder):
    return training(folder, "--steps", "400")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "whole"
    succeed(*train(folder), by=run_process)
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
        subprocess.run(["mount", "-o", "remount,size=64m", str(disk)], check=True)
        succeed("resume", disk / "run", by=run_process)
        assert (disk / "run/metrics.csv").read_bytes() == (whole / "metrics.csv").read_bytes()


@pytest.fixture
def others_run(whole):
    """A copy of the run that everybody can read, in a folder that everybody can enter."""
    with tempfile.TemporaryDirectory() as path:
        os.chmod(path, 0o755)
        run = shutil.copytree(whole, Path(path) / "run")
        subprocess.run(["chmod", "-R", "a+rX", str(run)], check=True)
        yield run


def run_as_nobody(*command):
    """Return exit code and stderr of a command that runs as another user."""
    python = ["setpriv", "--reuid=65534", "--regid=65534", "--clear-groups", sys.executable]
    env = {**ENVIRONMENT, "HOME": "/nonexistent"}
    if (
        shutil.which("setpriv") is None
        or subprocess.run([*python, "-c", "import earl_jax"], capture_output=True, env=env).returncode
    ):
        pytest.skip("running as another user needs root, and a Python that this user can read")
    done = subprocess.run([*python, "-m", "earl_jax.cli", *map(str, command)], capture_output=True, text=True, env=env)
    return done.returncode, done.stderr


def test_another_user_can_read_a_run_and_cannot_write_to_it(others_run, tmp_path):
    with unchanged(others_run):
        for command in (["table"], ["best"], ["evaluate", "--episodes", "1"]):
            code, err = run_as_nobody(command[0], others_run, *command[1:])
            assert code == 0, err
        assert "run/.lock can't be written to: Permission denied" in error_line(*run_as_nobody("resume", others_run))


@pytest.mark.parametrize(
    ("name", "cause"), [("checkpoints", "can't hold checkpoints"), ("metrics.csv", "can't be written to")]
)
def test_a_part_of_a_run_that_belongs_to_another_user_is_named_before_training(name, cause, others_run):
    for path in (others_run, *others_run.rglob("*")):
        os.chown(path, 65534, 65534)
    os.chown(others_run / name, 0, 0)
    with unchanged(others_run):
        code, err = run_as_nobody("resume", others_run, "--steps", "800")
    assert f"run/{name} {cause}: Permission denied" in error_line(code, err)
    assert err.count("\n") == 1


def test_clocks_that_jump_or_stand_still_change_nothing(whole, tmp_path):
    run_code(MAIN_WITH_A_JUMPING_CLOCK, *train(tmp_path / "run"), "--minutes", "60")
    assert (tmp_path / "run/metrics.csv").read_bytes() == (whole / "metrics.csv").read_bytes()
