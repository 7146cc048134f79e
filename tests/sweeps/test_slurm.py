"""Tests of the SLURM launcher, on a fake cluster that runs the tasks of an array on this machine."""

import os
import sys
import time

import pytest

from earl_jax.sweeps import launcher, slurm
from tests.cli.process import ENVIRONMENT
from tests.sweeps.conftest import GRID, write_executable


@pytest.fixture
def cluster(tmp_path, monkeypatch):
    """An `sbatch` that returns at once and then runs the tasks of an array here, one after another."""
    pytest.importorskip("submitit", reason="the extra [slurm] is not installed")
    bin_ = tmp_path / "bin"
    bin_.mkdir()
    write_executable(
        bin_ / "srun",
        '#!/bin/bash\nwhile [[ "$1" == --* ]]; do [[ $1 == --unbuffered ]] || shift; shift; done\nexec "$@"\n',
    )
    tasks = (
        "for i in $(seq 0 $last); do SLURM_JOB_ID=7$i SLURM_ARRAY_JOB_ID=7 SLURM_ARRAY_TASK_ID=$i SLURM_NTASKS=1"
        ' SLURM_JOB_NUM_NODES=1 SLURM_NODEID=0 SLURM_PROCID=0 SLURM_LOCALID=0 bash "$1"; done'
    )
    write_executable(
        bin_ / "sbatch",
        f"""#!/bin/bash
cp "$1" {tmp_path}/submitted.sh
last=$(sed -n 's/^#SBATCH --array=0-\\([0-9]*\\).*/\\1/p' "$1")
cp "$1" "$1.kept"
set -- "$1.kept"
({tasks}; touch {tmp_path}/ended) >{tmp_path}/cluster.log 2>&1 </dev/null &
echo "Submitted batch job 7"
""",
    )
    monkeypatch.setenv("PATH", f"{bin_}:{os.environ['PATH']}")
    for name, value in ENVIRONMENT.items():
        if name.startswith("JAX"):
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
    assert lines[2].startswith("0 jobs")


def test_a_job_fails_if_a_run_fails_and_is_submitted_again_after_a_time_out(workers):
    workers('emit("done") if name == "a" else emit("failed", why="ValueError: broken")\n')
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
        (("5",), None, "--slurm takes name=value, not '5'"),
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
