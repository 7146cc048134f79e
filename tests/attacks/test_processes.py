"""Limits of the system, and a folder that is moved while a process trains."""

import subprocess
import sys
import time

import pytest

from tests.cli.process import ENVIRONMENT, run, start, training

pytestmark = pytest.mark.slow
LIMITED = """
import resource, sys
resource.setrlimit(resource.{0}, ({1}, {1}))
from earl_jax.cli.main import main
main(sys.argv[1:])
"""


@pytest.mark.parametrize(("limit", "size"), [("RLIMIT_FSIZE", 2000), ("RLIMIT_FSIZE", 20_000), ("RLIMIT_NOFILE", 24)])
def test_a_limit_of_files_stops_with_an_error_line_and_the_run_continues_without_it(limit, size, whole, tmp_path):
    folder = tmp_path / "run"
    command = [sys.executable, "-c", LIMITED.format(limit, size), *training(folder)]
    result = subprocess.run(command, capture_output=True, text=True, env=ENVIRONMENT, timeout=300)
    assert result.returncode == 2, result.stderr
    assert "Traceback" not in result.stderr
    assert any(line.startswith("earl-jax: ") for line in result.stderr.splitlines())
    code, _, err = run(*(("resume", folder) if (folder / "metrics.csv").exists() else training(folder)))
    assert code == 0, err
    assert (folder / "metrics.csv").read_bytes() == (whole / "metrics.csv").read_bytes()


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
