"""Tests of the launcher: no jax, sweeps that continue after a kill, reported failures, SLURM arrays."""

import itertools
import json
import os
import signal
import stat
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from earl_jax import cli
from earl_jax.sweeps import launcher
from tests.cli.process import ENVIRONMENT, run_process, start

GRID = """
envs = ["tabletop_organization"]
algos = ["naive"]
seeds = 2
steps = 800
eval_every = 40
eval_episodes = 2
checkpoint_every = 200
[options]
hidden_sizes = [[16]]
batch_size = 16
random_steps = 20
reward_scale = [1, 10]
"""
FAKE_WORKER = """
import json, os, signal, sys
if sys.argv[1] == "plan":
    runs = {name: {"step": 0, "config": {}} for name in "abcdef"}
    sizes = {"lanes": 1, "step": 0, "steps": 40, "replay_bytes": 0}
    groups = [{"runs": names, **sizes} for names in (["a", "b"], ["c"], ["d"], ["e"])]
    print(json.dumps({"out": sys.argv[4], "runs": runs, "groups": groups}))
    sys.exit()
runs = list(json.loads(sys.stdin.readline())["runs"])
emit = lambda state, **details: print(json.dumps({"run": runs[-1], "state": state, **details}), flush=True)
print("a stray line", flush=True)
if runs == ["c"]:
    emit("resumed", step=40)
    os.kill(os.getpid(), signal.SIGKILL)
if runs == ["d"]:
    emit("failed", why="ValueError: broken")
    sys.exit(1)
emit("done")
"""


@pytest.fixture
def grid(tmp_path):
    """The TOML file of `GRID`."""
    path = tmp_path / "grid.toml"
    path.write_text(GRID)
    return path


def read_tables(out):
    """Return the bytes of every metrics.csv of the sweep at `out`."""
    return {path.relative_to(out): path.read_bytes() for path in out.glob("*/*/*/metrics.csv")}


def test_the_launcher_never_imports_jax(grid, tmp_path):
    code = (
        "import sys, earl_jax.sweeps.launcher; from earl_jax.cli import main;"
        f"main(['sweep', {str(grid)!r}, '--out', {str(tmp_path / 'out')!r}, '--dry-run']);"
        "assert not {'jax', 'numpy', 'flax', 'mujoco'} & set(sys.modules), sorted(sys.modules)"
    )
    process = subprocess.run([sys.executable, "-c", code], env=ENVIRONMENT, capture_output=True, text=True)
    assert process.returncode == 0, process.stderr
    assert "program 1: 4 lanes, steps 0 to 800, replay" in process.stdout
    assert "2 runs, 0 of them done; programs to run: 1" in process.stdout
    assert not (tmp_path / "out").exists()
    code = "import sys; from earl_jax.cli import main\ntry: main(['--help'])\nexcept SystemExit: pass\n"
    process = subprocess.run([sys.executable, "-c", code + "assert 'jax' not in sys.modules"], capture_output=True)
    assert process.returncode == 0, process.stderr


@pytest.mark.slow
def test_a_sweep_continues_after_a_kill_and_loses_nothing(grid, tmp_path):
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    code, out, err = run_process("sweep", grid, "--out", whole)
    assert code == 0, err
    assert "2 runs: 0 done before, 2 done now, 0 failed" in out
    process = start("sweep", grid, "--out", killed)
    deadline = time.monotonic() + 240
    while not list(killed.glob("*/*/*/checkpoints/0*")) and time.monotonic() < deadline:
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)  # only the launcher, so that its worker must notice
    process.communicate()
    assert process.returncode == -signal.SIGKILL
    assert read_tables(killed) != read_tables(whole)
    code, out, err = run_process("sweep", grid, "--out", killed)
    assert code == 0, err
    assert out.count("resumed ") + out.count("started ") == 2
    assert read_tables(killed) == read_tables(whole)
    assert len(read_tables(whole)) == 2
    assert all(len(table.splitlines()) == 1 + 2 * 20 for table in read_tables(whole).values())
    before = read_tables(killed)
    code, out, _ = run_process("sweep", grid, "--out", killed, "--json")
    assert code == 0
    assert json.loads(out)["lines"][-1] == "2 runs: 2 done before, 0 done now, 0 failed"
    assert read_tables(killed) == before


@pytest.fixture
def fake_worker(tmp_path, monkeypatch):
    """Replace the worker by a script that fails in several ways."""
    script = tmp_path / "worker.py"
    script.write_text(FAKE_WORKER)
    monkeypatch.setattr(launcher, "WORKER", [sys.executable, str(script)])


@pytest.mark.usefixtures("fake_worker")
def test_a_failed_group_is_reported_and_the_next_group_runs(grid, tmp_path, capsys):
    lines = []
    assert launcher.sweep(grid, tmp_path, emit=lines.append) == (3, ())
    assert lines == [
        "done       f  (before)",
        "done       b",
        "failed     a  the worker ended with code 0",
        "resumed    c  from step 40",
        "failed     c  the worker was ended by signal 9",
        "failed     d  ValueError: broken",
        "done       e",
        "6 runs: 1 done before, 2 done now, 3 failed",
    ]
    assert capsys.readouterr().err.count("a stray line") == 4


@pytest.mark.usefixtures("fake_worker")
def test_a_failed_sweep_exits_with_code_1(grid, tmp_path, capsys):
    with pytest.raises(SystemExit) as exit_info:
        cli.main(["sweep", str(grid), "--out", str(tmp_path)])
    assert exit_info.value.code == 1
    assert "3 failed" in capsys.readouterr().out


@pytest.mark.usefixtures("fake_worker")
def test_json_of_a_dry_run_has_the_runs_and_groups(grid, tmp_path, capsys):
    cli.main(["sweep", str(grid), "--out", str(tmp_path), "--dry-run", "--json"])
    plan = json.loads(capsys.readouterr().out)
    assert plan["out"] == str(tmp_path)
    assert list(plan["runs"]) == list("abcdef")
    assert plan["runs"]["a"] == {"step": 0, "config": {}}
    assert plan["groups"][0]["lanes"] == 1


@pytest.mark.usefixtures("fake_worker")
def test_a_job_fails_if_one_of_its_runs_fails():
    launcher.GroupJob()({"out": "", "runs": {"e": {}}})
    with pytest.raises(RuntimeError, match="d: ValueError: broken"):
        launcher.GroupJob()({"out": "", "runs": {"d": {}}})


def executable(path, text):
    path.write_text(text)
    path.chmod(path.stat().st_mode | stat.S_IXUSR)


@pytest.fixture
def cluster(tmp_path, monkeypatch):
    """An `sbatch` that returns at once and then runs the tasks of an array here, one after another."""
    pytest.importorskip("submitit", reason="the extra [slurm] is not installed")
    bin_ = tmp_path / "bin"
    bin_.mkdir()
    executable(
        bin_ / "srun",
        '#!/bin/bash\nwhile [[ "$1" == --* ]]; do [[ $1 == --unbuffered ]] || shift; shift; done\nexec "$@"\n',
    )
    tasks = (
        "for i in $(seq 0 $last); do SLURM_JOB_ID=7$i SLURM_ARRAY_JOB_ID=7 SLURM_ARRAY_TASK_ID=$i SLURM_NTASKS=1"
        ' SLURM_JOB_NUM_NODES=1 SLURM_NODEID=0 SLURM_PROCID=0 SLURM_LOCALID=0 bash "$1"; done'
    )
    executable(
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


def test_a_slurm_array_has_one_task_per_program_group(grid, cluster):
    grid.write_text(GRID.replace("steps = 800", "steps = 120"))
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
    assert len(read_tables(out)) == 2
    lines.clear()
    assert launcher.sweep(grid, out, **arguments) == (0, ())
    assert [line[:4] for line in lines[:2]] == ["done", "done"]
    assert lines[2].startswith("0 jobs")


def test_a_job_that_timed_out_is_submitted_again():
    pytest.importorskip("submitit", reason="the extra [slurm] is not installed")
    task = {"out": "x", "runs": {}}
    resubmitted = launcher.GroupJob().checkpoint(task)
    assert isinstance(resubmitted.function, launcher.GroupJob)
    assert resubmitted.args == (task,)


@pytest.mark.parametrize(
    ("slurm", "message"),
    [((), "needs a time limit"), (("time=5", "party=x"), "Unavailable parameter.*partition")],
)
def test_invalid_slurm_options_are_refused_before_any_submission(grid, cluster, slurm, message):
    with pytest.raises(ValueError, match=message):
        launcher.sweep(grid, cluster / "out", "slurm", slurm=slurm)
    assert not (cluster / "out").exists()


def test_missing_slurm_or_unknown_launcher_is_refused(grid, tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, "submitit", None)
        with pytest.raises(ValueError, match=r"pip install 'earl-jax\[slurm\]'"):
            launcher.sweep(grid, tmp_path / "out", "slurm", slurm=("time=5",))
    pytest.importorskip("submitit", reason="the extra [slurm] is not installed")
    monkeypatch.setenv("PATH", str(Path(tmp_path, "empty")))
    with pytest.raises(ValueError, match="on a machine that has sbatch"):
        launcher.sweep(grid, tmp_path / "out", "slurm", slurm=("time=5",))
    with pytest.raises(ValueError, match="choose from local, slurm"):
        launcher.sweep(grid, tmp_path / "out", "cloud")


def test_minutes_of_a_slurm_sweep_are_refused(grid, tmp_path):
    with pytest.raises(ValueError, match="--slurm time=MINUTES limits each job"):
        launcher.sweep(grid, tmp_path / "out", "slurm", slurm=("time=5",), minutes=5)


SLOW_WORKER = """
import json, os, signal, sys, time
if sys.argv[1] == "plan":
    groups = [{"runs": [name], "lanes": 1, "step": 0, "steps": 40, "replay_bytes": 0} for name in "ab"]
    print(json.dumps({"out": sys.argv[4], "runs": {name: {"step": 0, "config": {}} for name in "ab"}, "groups": groups}))
    sys.exit()
name = list(json.loads(sys.stdin.readline())["runs"])[0]
emit = lambda state: print(json.dumps({"run": name, "state": state}), flush=True)
def save_and_end(number, frame):
    print("saved", flush=True)
    sys.exit(128 + number)
signal.signal(signal.SIGTERM, save_and_end)
emit("started")
time.sleep(60)
"""


def test_a_stopped_sweep_lets_its_worker_save_and_starts_no_other_group(grid, tmp_path, monkeypatch, capsys):
    script, lines = tmp_path / "worker.py", []
    script.write_text(SLOW_WORKER)
    monkeypatch.setattr(launcher, "WORKER", [sys.executable, str(script)])

    def emit(line):
        lines.append(line)
        if line.startswith("started"):
            os.kill(os.getpid(), signal.SIGTERM)

    with pytest.raises(SystemExit) as exit_info:
        launcher.sweep(grid, tmp_path, emit=emit)
    assert exit_info.value.code == 128 + signal.SIGTERM
    assert lines == [
        "started    a",
        "stopped    a  the worker ended with code 143",
        "stopped; repeat the command to continue",
    ]
    assert "saved" in capsys.readouterr().err
    assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL


STOPPING_WORKER = """
import json, sys
if sys.argv[1] == "plan":
    groups = [{"runs": names, "lanes": 1, "step": 0, "steps": 40, "replay_bytes": 0} for names in (["a", "b"], ["c"])]
    print(json.dumps({"out": sys.argv[4], "runs": {name: {"step": 0, "config": {}} for name in "abcd"}, "groups": groups}))
    sys.exit()
minutes, ends_at = json.loads(sys.stdin.readline())["limit"]
for run, event in [("a", {"state": "done"}), ("b", {"state": "started"}), ("b", {"state": "stopped", "step": ends_at})]:
    print(json.dumps({"run": run, **event}), flush=True)
"""


def test_a_sweep_whose_minutes_run_out_starts_no_other_group(grid, tmp_path, monkeypatch, capsys):
    script, clock = tmp_path / "worker.py", itertools.chain([1000.0, 1000.0], itertools.repeat(1200.0))
    script.write_text(STOPPING_WORKER)
    monkeypatch.setattr(launcher, "WORKER", [sys.executable, str(script)])
    monkeypatch.setattr("earl_jax.options.time", SimpleNamespace(time=lambda: next(clock)))
    lines = []
    assert launcher.sweep(grid, tmp_path, emit=lines.append, minutes=2) == (0, ("b", "c"))
    assert lines == [
        "done       d  (before)",
        "done       a",
        "started    b",
        "stopped    b  at step 1120.0",
        "4 runs: 1 done before, 1 done now, 0 failed, 2 unfinished after 2 minutes; repeat the command to continue",
    ]
    monkeypatch.undo()
    monkeypatch.setattr(launcher, "WORKER", [sys.executable, str(script)])
    cli.main(["sweep", str(grid), "--out", str(tmp_path), "--minutes", "1e-9", "--json"])
    printed = json.loads(capsys.readouterr().out)
    assert (printed["failed"], printed["stopped"], printed["unfinished"]) == (0, True, ["a", "b", "c"])
    assert printed["resume"] == "repeat the command"


def test_slurm_logs_are_not_written_through_a_link(grid, tmp_path):
    pytest.importorskip("submitit", reason="the extra [slurm] is not installed")
    (tmp_path / "victim").mkdir()
    (tmp_path / "slurm").symlink_to(tmp_path / "victim")
    with pytest.raises(ValueError, match="slurm is a link"):
        launcher.sweep(grid, tmp_path, "slurm", slurm=("time=5",))
    assert list((tmp_path / "victim").iterdir()) == []
