"""The SLURM launcher, on a fake cluster that runs the tasks of an array on this machine."""

import os
import sys
import time

import pytest

from earl_jax.sweeps import launcher, slurm
from tests.cli.process import ADDED
from tests.sweeps.conftest import GRID, write_executable

SRUN = '#!/bin/bash\nwhile [[ "$1" == --* ]]; do [[ $1 == --unbuffered ]] || shift; shift; done\nexec "$@"\n'
SBATCH = """#!/bin/bash
cp "$1" FOLDER/submitted.sh
last=$(sed -n 's/^#SBATCH --array=0-\\([0-9]*\\).*/\\1/p' "$1")
cp "$1" "$1.kept"
set -- "$1.kept"
export SLURM_ARRAY_JOB_ID=7 SLURM_NTASKS=1 SLURM_JOB_NUM_NODES=1 SLURM_NODEID=0 SLURM_PROCID=0 SLURM_LOCALID=0
(for i in $(seq 0 $last); do SLURM_JOB_ID=7$i SLURM_ARRAY_TASK_ID=$i bash "$1"; done
 touch FOLDER/ended) >FOLDER/cluster.log 2>&1 </dev/null &
echo "Submitted batch job 7"
"""


@pytest.fixture
def cluster(tmp_path, monkeypatch):
    """A folder with an `sbatch` that returns at once and then runs the tasks of an array here, one after another."""
    pytest.importorskip("submitit", reason="the extra [slurm] is not installed")
    (tmp_path / "bin").mkdir()
    write_executable(tmp_path / "bin/srun", SRUN)
    write_executable(tmp_path / "bin/sbatch", SBATCH.replace("FOLDER", str(tmp_path)))
    for name, value in {**ADDED, "PATH": f"{tmp_path / 'bin'}:{os.environ['PATH']}"}.items():
        monkeypatch.setenv(name, value)
    return tmp_path


@pytest.mark.slow
def test_an_array_has_one_task_per_program_group(grid, cluster):
    grid.write_text(GRID.replace("steps = 120", "steps = 40"))
    out, lines = cluster / "out", []
    arguments = {"launcher": "slurm", "max_lanes": 2, "slurm": ("time=30", "partition=fast"), "emit": lines.append}
    assert launcher.sweep(grid, out, **arguments) == (0, ())
    assert [line.rsplit("  ", 1)[1] for line in lines[:2]] == ["job 7_0", "job 7_1"]
    script = (cluster / "submitted.sh").read_text()
    for option in ("--array=0-1", "--time=30", "--partition=fast", "--job-name=earl-jax"):
        assert option in script
    deadline = time.monotonic() + 240
    while not (cluster / "ended").exists() and time.monotonic() < deadline:
        time.sleep(0.1)
    log = (cluster / "cluster.log").read_text()
    assert log.count('"state": "done"') == log.count("Job completed successfully") == 2, log
    lines.clear()
    assert launcher.sweep(grid, out, **arguments) == (0, ())
    assert [line[:4] for line in lines[:2]] == ["done", "done"]
    assert lines[2].startswith(f"0 jobs; logs in {out / 'slurm'}")


def test_a_job_fails_if_a_run_fails_and_is_submitted_again_after_a_time_out(workers):
    workers('emit("done") if name == "a" else emit("failed", "ValueError: broken")\n')
    slurm.GroupJob()({"out": "", "runs": {"a": {}}})
    task = {"out": "", "runs": {"b": {}}}
    with pytest.raises(RuntimeError, match="b: ValueError: broken"):
        slurm.GroupJob()(task)
    pytest.importorskip("submitit", reason="the extra [slurm] is not installed")
    again = slurm.GroupJob().checkpoint(task)
    assert (type(again.function), again.args) == (slurm.GroupJob, (task,))


@pytest.mark.parametrize(
    ("parameters", "missing", "message"),
    [
        ((), None, "needs a time limit"),
        (("time=5", "party=x"), None, "Unavailable parameter.*partition"),
        (("time=5",), "submitit", r"pip install 'earl-jax\[slurm\]'"),
        (("time=5",), "sbatch", "on a machine that has sbatch"),
        (("time=5",), "folder", "slurm is a link"),
    ],
)
def test_invalid_options_and_missing_programs_are_refused(grid, cluster, monkeypatch, parameters, missing, message):
    if missing == "submitit":
        monkeypatch.setitem(sys.modules, "submitit", None)
    elif missing == "sbatch":
        monkeypatch.setenv("PATH", str(cluster / "empty"))
    elif missing == "folder":
        (cluster / "out").mkdir()
        (cluster / "out/slurm").symlink_to(cluster)
    with pytest.raises(ValueError, match=message):
        launcher.sweep(grid, cluster / "out", "slurm", slurm=parameters)
    assert not (cluster / "submitted.sh").exists()
