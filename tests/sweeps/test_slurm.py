"""The SLURM launcher, on a cluster of one node that the tests start on this machine."""

import contextlib
import os
import re
import shutil
import signal
import socket
import subprocess

import pytest

from earl_jax.sweeps import slurm
from tests.cli.process import ENVIRONMENT, free_port, run_process, succeed, wait_until
from tests.conftest import write_mine
from tests.sweeps.conftest import GRID, read_tables

PROGRAMS = ("munged", "slurmctld", "slurmd", "sbatch")
MUNGE_FILES = ("socket", "key-file", "log-file", "pid-file", "seed-file")
CONFIG = """
ClusterName=test
SlurmctldHost={node}(127.0.0.1)
SlurmctldPort={ports[0]}
SlurmdPort={ports[1]}
SlurmUser=root
# A job that returns to the queue waits until its credential has expired.
AuthInfo=socket={folder}/munge.socket,cred_expire=5
StateSaveLocation={folder}
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
ProctrackType=proctrack/pgid
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
NodeName={node} NodeAddr=127.0.0.1 CPUs={cores}
PartitionName=main Nodes={node} Default=YES
"""
LONG = GRID.replace("steps = 120", "steps = 4000").replace("checkpoint_every = 40", "checkpoint_every = 4000")
NODE = socket.gethostname().partition(".")[0]


def ask(*command):
    """Return the output of one of SLURM's programs."""
    return subprocess.run(command, env=ENVIRONMENT, stdout=subprocess.PIPE, text=True, timeout=60).stdout


def wait_for(condition):
    assert wait_until(condition, 90), (ask("squeue"), ask("sinfo"))


def queue_is_empty():
    return not ask("squeue", "--noheader")


@contextlib.contextmanager
def running(command, folder):
    with (folder / f"{command[0]}.log").open("w") as log:
        process = subprocess.Popen(command, env=ENVIRONMENT, stdout=log, stderr=log)
    try:
        yield
    finally:
        process.terminate()
        process.wait(30)


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """A SLURM cluster of one node with all cores of this machine."""
    missing = [name for name in PROGRAMS if shutil.which(name) is None]
    if missing or os.geteuid() != 0:
        pytest.skip(f"a cluster of SLURM needs {', '.join(missing) or 'root'}")
    folder = tmp_path_factory.mktemp("slurm")
    (folder / "spool").mkdir()
    (folder / "munge.key-file").write_bytes(os.urandom(128))
    (folder / "munge.key-file").chmod(0o600)
    config = CONFIG.format(folder=folder, node=NODE, ports=[free_port(), free_port()], cores=os.cpu_count())
    (folder / "slurm.conf").write_text(config)
    munged = ["munged", "--foreground", "--force", *(f"--{name}={folder}/munge.{name}" for name in MUNGE_FILES)]
    with pytest.MonkeyPatch.context() as patch, contextlib.ExitStack() as stack:
        patch.setitem(ENVIRONMENT, "SLURM_CONF", str(folder / "slurm.conf"))
        for command in (munged, ["slurmctld", "-D"], ["slurmd", "-D"]):
            stack.enter_context(running(command, folder))
        wait_for(lambda: ask("sinfo", "--noheader", "--format=%T") == "idle\n")
        yield
        ask("scancel", "--user=root")
        wait_for(queue_is_empty)


@pytest.fixture(scope="module")
def whole(cluster, tmp_path_factory):
    """The metrics of the runs of LONG, trained at once and without SLURM."""
    folder = tmp_path_factory.mktemp("whole")
    (folder / "grid.toml").write_text(LONG)
    succeed("sweep", folder / "grid.toml", "--out", folder / "out", by=run_process)
    return read_tables(folder / "out")


def submit(grid, *options):
    """Return the lines that a sweep of `grid` prints, and its messages."""
    arguments = ["--max-lanes", "4", "--launcher", "slurm", "--slurm", "time=10", *options]
    _, out, err = run_process("sweep", grid, "--out", grid.parent / "out", *arguments)
    return out.splitlines(), err


def reach_time_limit(job, log):
    """Let the worker stop while SLURM, which looks every 30 seconds, finds that the time is nearly over."""
    workers = [int(line.split()[0]) for line in ask("scontrol", "listpids").splitlines() if " - " in line]
    for worker in workers:
        os.kill(worker, signal.SIGSTOP)
    ask("scontrol", "update", f"JobId={job}", "TimeLimit=1")
    wait_for(lambda: "the time limit is near" in log.read_text())
    ask("scontrol", "update", f"JobId={job}", "TimeLimit=10")
    for worker in workers:
        os.kill(worker, signal.SIGCONT)


def drain(job, log):
    ask("scontrol", "update", f"NodeName={NODE}", "State=drain", "Reason=test")
    ask("scontrol", "requeue", job)
    wait_for(lambda: ask("squeue", "--noheader", "--format=%T") == "PENDING\n")
    wait_for(lambda: ask("sinfo", "--noheader", "--format=%T") == "drained\n")
    ask("scontrol", "update", f"NodeName={NODE}", "State=resume")


def cancel(job, log):
    ask("scancel", job)
    wait_for(queue_is_empty)


def interrupt(end, job, out):
    """Let `end` end the job after its next evaluation, and check that it saves a checkpoint."""
    log, rows = out / f"slurm/{job}.log", read_tables(out)
    wait_for(lambda: read_tables(out) != rows)
    before = log.read_text().count("stopped at step")
    end(job, log)
    wait_for(lambda: log.read_text().count("stopped at step") > before)
    step = re.findall(r"stopped at step (\d+) by SIGTERM", log.read_text())[-1]
    assert step.zfill(9) in {path.name for path in out.glob("*/*/*/checkpoints/*")}


@pytest.mark.slow
def test_a_job_that_slurm_ends_saves_and_continues_to_the_same_numbers(grid, whole):
    grid.write_text(LONG)
    lines, err = submit(grid)
    assert len(lines) == 3, err
    job, out = lines[0].rpartition(" ")[2], grid.parent / "out"
    for end in (reach_time_limit, drain, cancel):
        interrupt(end, job, out)
    assert read_tables(out) != whole
    submit(grid)
    wait_for(queue_is_empty)
    assert read_tables(out) == whole


@pytest.mark.slow
def test_a_sweep_of_four_runs_is_an_array_with_a_task_for_each_program(cluster, grid):
    write_mine(grid.parent)
    text = GRID.replace("steps = 120", "steps = 40").replace("[1, 10]", "[1, 3, 10, 30]").replace("oracle", "patient")
    grid.write_text(f'import = ["mine.py"]\n{text}')
    assert re.fullmatch(
        "earl-jax: .* cannot submit a job: .*unrecognized option '--party=x'.*\n", submit(grid, "party=x")[1]
    )
    lines, err = submit(grid, "job_name=four", "array_parallelism=2")
    assert [line[-2:] for line in lines[:4]] == ["_0", "_0", "_1", "_1"], err
    assert "four 10:00" in ask("squeue", "--noheader", "--format=%j %l")
    assert "ArrayTaskThrottle=2" in ask("scontrol", "show", "job")
    wait_for(queue_is_empty)
    logs = [path.read_text() for path in (grid.parent / "out/slurm").glob("*.log")]
    assert [log.count('"state": "done"') for log in logs] == [2, 2], logs
    lines, err = submit(grid)
    assert [line[:4] for line in lines[:4]] == ["done"] * 4, err
    assert lines[4] == "0 jobs; no run is unfinished"


@pytest.mark.parametrize(
    ("obstacle", "message"),
    [("program", "cannot submit a job: .*No such file or directory: 'sbatch'"), ("link", "slurm is a link")],
)
def test_an_array_that_cannot_be_submitted_leaves_nothing(tmp_path, monkeypatch, obstacle, message):
    if obstacle == "program":
        monkeypatch.setenv("PATH", str(tmp_path))
    else:
        (tmp_path / "slurm").symlink_to(tmp_path)
    there = list(tmp_path.iterdir())
    with pytest.raises(ValueError, match=message):
        slurm.submit(tmp_path, [{"runs": {"a": {}}}], {}, print)
    assert list(tmp_path.iterdir()) == there
