"""Sweeps from the launcher's side: no jax, nothing lost in a kill, failures told, SLURM arrays submitted."""

import json
import os
import signal
import stat
import subprocess
import sys
import time
from pathlib import Path

import pytest

from earl_jax.sweeps import launcher as sweep
from tests.test_cli import ENVIRONMENT, run, start

GRID = """
envs = ["tabletop_organization"]
algos = ["naive"]
seeds = 2
steps = 800
eval_every = 40
eval_episodes = 2
checkpoint_every = 200
[options]
hidden_sizes = [[16, 16]]
batch_size = 16
random_steps = 20
reward_scale = [1, 10]
"""
FAKE_WORKER = """
import json, os, signal, sys
if sys.argv[1] == "plan":
    one = {"step": 0, "experiment": {}}
    packs = [{"cells": ["a", "b"]}, {"cells": ["c"]}, {"cells": ["d"]}, {"cells": ["e"]}]
    print(json.dumps({"out": sys.argv[4], "cells": {name: one for name in "abcdef"}, "packs": packs}))
    sys.exit()
cells = list(json.loads(sys.stdin.readline())["cells"])
say = lambda state, **more: print(json.dumps({"cell": cells[-1], "state": state, **more}), flush=True)
print("a stray line", flush=True)
if cells == ["c"]:
    say("resumed", step=40)
    os.kill(os.getpid(), signal.SIGKILL)
if cells == ["d"]:
    say("failed", why="ValueError: broken")
    sys.exit(1)
say("done")
"""


@pytest.fixture
def grid(tmp_path):
    path = tmp_path / "grid.toml"
    path.write_text(GRID)
    return path


def tables(out):
    return {path.relative_to(out): path.read_bytes() for path in out.glob("*/*/*/metrics.csv")}


def test_the_launcher_never_imports_jax(grid, tmp_path):
    code = (
        "import sys, earl_jax.sweeps.launcher; from earl_jax.cli.main import main;"
        f"main(['sweep', {str(grid)!r}, '--out', {str(tmp_path / 'out')!r}, '--dry-run']);"
        "assert not {'jax', 'numpy', 'flax', 'mujoco'} & set(sys.modules), sorted(sys.modules)"
    )
    found = subprocess.run([sys.executable, "-c", code], env=ENVIRONMENT, capture_output=True, text=True)
    assert found.returncode == 0, found.stderr
    assert "pack 1: 4 lanes, steps 0 to 800, replay" in found.stdout
    assert "2 cells, 0 of them done; 1 programs" in found.stdout
    assert not (tmp_path / "out").exists()
    helped = "import sys; from earl_jax.cli.main import main\ntry: main(['--help'])\nexcept SystemExit: pass\n"
    found = subprocess.run([sys.executable, "-c", helped + "assert 'jax' not in sys.modules"], capture_output=True)
    assert found.returncode == 0, found.stderr


@pytest.mark.slow
def test_a_killed_sweep_goes_on_and_loses_nothing(grid, tmp_path):
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    code, out, err = run("sweep", grid, "--out", whole)
    assert code == 0, err
    assert "2 cells: 0 done before, 2 done now, 0 failed" in out
    process = start("sweep", grid, "--out", killed)
    deadline = time.monotonic() + 240
    while not list(killed.glob("*/*/*/checkpoints/0*")) and time.monotonic() < deadline:
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)  # the launcher alone: its worker has to notice
    process.communicate()
    assert process.returncode == -signal.SIGKILL
    assert tables(killed) != tables(whole)
    code, out, err = run("sweep", grid, "--out", killed)
    assert code == 0, err
    assert out.count("resumed ") + out.count("started ") == 2
    assert tables(killed) == tables(whole)
    assert len(tables(whole)) == 2
    assert all(len(table.splitlines()) == 1 + 2 * 20 for table in tables(whole).values())
    before = tables(killed)
    code, out, _ = run("sweep", grid, "--out", killed, "--json")
    assert code == 0
    assert json.loads(out)["lines"][-1] == "2 cells: 2 done before, 0 done now, 0 failed"
    assert tables(killed) == before


@pytest.fixture
def fake_worker(tmp_path, monkeypatch):
    script = tmp_path / "worker.py"
    script.write_text(FAKE_WORKER)
    monkeypatch.setattr(sweep, "WORKER", [sys.executable, str(script)])


@pytest.mark.usefixtures("fake_worker")
def test_a_pack_that_fails_is_told_and_the_next_one_runs(grid, tmp_path, capsys):
    lines = []
    assert sweep.sweep(grid, tmp_path, say=lines.append) == 3
    assert lines == [
        "done       f  (before)",
        "done       b",
        "failed     a  the worker ended with code 0",
        "resumed    c  from step 40",
        "failed     c  the worker was ended by signal 9",
        "failed     d  ValueError: broken",
        "done       e",
        "6 cells: 1 done before, 2 done now, 3 failed",
    ]
    assert capsys.readouterr().err.count("a stray line") == 4


@pytest.mark.usefixtures("fake_worker")
def test_a_failed_sweep_ends_with_one(grid, tmp_path, capsys):
    from earl_jax.cli.main import main

    with pytest.raises(SystemExit) as ended:
        main(["sweep", str(grid), "--out", str(tmp_path)])
    assert ended.value.code == 1
    assert "3 failed" in capsys.readouterr().out


@pytest.mark.usefixtures("fake_worker")
def test_the_work_of_a_job_fails_with_its_cells():
    sweep.Work()({"out": "", "cells": {"e": {}}})
    with pytest.raises(RuntimeError, match="d: ValueError: broken"):
        sweep.Work()({"out": "", "cells": {"d": {}}})


def executable(path, text):
    path.write_text(text)
    path.chmod(path.stat().st_mode | stat.S_IXUSR)


@pytest.fixture
def cluster(tmp_path, monkeypatch):
    """A `sbatch` that runs the tasks of an array here, one after the other, after it has answered."""
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


def test_a_slurm_array_has_a_task_for_each_pack(grid, cluster):
    grid.write_text(GRID.replace("steps = 800", "steps = 120"))
    out, lines = cluster / "out", []
    arguments = {"launcher": "slurm", "max_lanes": 2, "slurm": ("time=30", "partition=fast"), "say": lines.append}
    assert sweep.sweep(grid, out, **arguments) == 0
    assert [line.rsplit("  ", 1)[1] for line in lines[:2]] == ["job 7_0", "job 7_1"]
    script = (cluster / "submitted.sh").read_text()
    for words in ("--array=0-1", "--time=30", "--partition=fast", "--job-name=earl-jax"):
        assert words in script
    deadline = time.monotonic() + 240
    while not (cluster / "ended").exists() and time.monotonic() < deadline:
        time.sleep(0.1)
    log = (cluster / "cluster.log").read_text()
    assert log.count('"state": "done"') == log.count("Job completed successfully") == 2, log
    assert len(tables(out)) == 2
    lines.clear()
    assert sweep.sweep(grid, out, **arguments) == 0
    assert [line[:4] for line in lines[:2]] == ["done", "done"]
    assert lines[2].startswith("0 jobs")


def test_a_job_out_of_time_is_submitted_again():
    pytest.importorskip("submitit", reason="the extra [slurm] is not installed")
    task = {"out": "x", "cells": {}}
    again = sweep.Work().checkpoint(task)
    assert isinstance(again.function, sweep.Work)
    assert again.args == (task,)


@pytest.mark.parametrize(
    ("slurm", "words"),
    [((), "needs a time limit"), (("time=5", "party=x"), "Unavailable parameter.*partition")],
)
def test_slurm_options_are_checked_before_anything(grid, cluster, slurm, words):
    with pytest.raises(ValueError, match=words):
        sweep.sweep(grid, cluster / "out", "slurm", slurm=slurm)
    assert not (cluster / "out").exists()


def test_where_there_is_no_slurm_the_launcher_says_so(grid, tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, "submitit", None)
        with pytest.raises(ValueError, match=r"pip install 'earl-jax\[slurm\]'"):
            sweep.sweep(grid, tmp_path / "out", "slurm", slurm=("time=5",))
    pytest.importorskip("submitit", reason="the extra [slurm] is not installed")
    monkeypatch.setenv("PATH", str(Path(tmp_path, "empty")))
    with pytest.raises(ValueError, match="runs where sbatch does"):
        sweep.sweep(grid, tmp_path / "out", "slurm", slurm=("time=5",))
    with pytest.raises(ValueError, match="choose from local, slurm"):
        sweep.sweep(grid, tmp_path / "out", "cloud")
