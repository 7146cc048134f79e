"""Limits of the system, and changes by others while a process trains."""

import subprocess
import sys

import pytest

from tests.cli.process import ENVIRONMENT, run_process, start, succeed, training, wait_until

pytestmark = pytest.mark.slow
LIMITED = """
import resource, sys
resource.setrlimit(resource.{0}, ({1}, {1}))
from earl_jax.cli.main import main
main(sys.argv[1:])
"""


@pytest.mark.parametrize(
    ("limit", "size"),
    [("RLIMIT_FSIZE", 2000), ("RLIMIT_FSIZE", 20_000), ("RLIMIT_FSIZE", 200_000), ("RLIMIT_NOFILE", 24)],
)
def test_a_limit_of_files_stops_with_an_error_line_and_the_run_continues_without_it(limit, size, whole, tmp_path):
    folder = tmp_path / "run"
    command = [sys.executable, "-c", LIMITED.format(limit, size), *training(folder)]
    result = subprocess.run(command, capture_output=True, text=True, env=ENVIRONMENT, timeout=300)
    if result.returncode:
        assert result.returncode == 2, result.stderr
        assert "Traceback" not in result.stderr
        assert any(line.startswith("earl-jax: ") for line in result.stderr.splitlines())
        succeed(*(("resume", folder) if (folder / "metrics.csv").exists() else training(folder)), by=run_process)
    assert (folder / "metrics.csv").read_bytes() == (whole / "metrics.csv").read_bytes()


def test_of_two_equal_commands_one_finishes_and_one_is_refused(whole, tmp_path):
    processes = [start(*training(tmp_path / "run")) for _ in range(2)]
    outcomes = sorted((process.communicate(timeout=300)[1], process.returncode) for process in processes)
    assert sorted(code for _, code in outcomes) == [0, 2]
    assert all("Traceback" not in err for err, _ in outcomes)
    assert (tmp_path / "run/metrics.csv").read_bytes() == (whole / "metrics.csv").read_bytes()


def test_a_folder_that_is_moved_in_training_ends_it_with_a_line_and_can_be_resumed(whole, tmp_path):
    process = start(*training(tmp_path / "run"))
    assert wait_until((tmp_path / "run/metrics.csv").exists)
    moved = (tmp_path / "run").rename(tmp_path / "moved")
    _, err = process.communicate(timeout=300)
    assert process.returncode in (0, 2), err
    assert "Traceback" not in err
    succeed("resume", moved, by=run_process)
    assert (moved / "metrics.csv").read_bytes() == (whole / "metrics.csv").read_bytes()
