"""Tests of the launcher on this machine: no jax, reported failures, signals, minutes, kills, and several workers at a time."""

import itertools
import json
import os
import signal
import subprocess
import sys
import time
from types import SimpleNamespace

import pytest

from earl_jax import cli
from earl_jax.sweeps import launcher, processes, slots
from tests.cli.process import ENVIRONMENT, run_process, start
from tests.sweeps.conftest import GRID


def test_the_launcher_never_imports_jax(grid, tmp_path):
    code = (
        "import sys, earl_jax.sweeps.launcher; from earl_jax.cli import main;"
        f"main(['sweep', {str(grid)!r}, '--out', {str(tmp_path / 'out')!r}, '--dry-run']);"
        "assert not {'jax', 'numpy', 'flax', 'mujoco'} & set(sys.modules), sorted(sys.modules)"
    )
    process = subprocess.run([sys.executable, "-c", code], env=ENVIRONMENT, capture_output=True, text=True)
    assert process.returncode == 0, process.stderr
    assert "program 1: 4 lanes, steps 0 to 120, replay" in process.stdout
    assert "2 runs, 0 of them done; programs to run: 1" in process.stdout
    assert not (tmp_path / "out").exists()


def read_tables(out):
    """Return the bytes of every metrics.csv of the sweep at `out`."""
    return {path.relative_to(out): path.read_bytes() for path in out.glob("*/*/*/metrics.csv")}


@pytest.mark.slow
def test_a_sweep_continues_after_a_kill_and_loses_nothing(grid, tmp_path):
    grid.write_text(GRID.replace("steps = 120", "steps = 800"))
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
    assert read_tables(killed) != read_tables(whole)
    code, out, err = run_process("sweep", grid, "--out", killed)
    assert code == 0, err
    assert out.count("resumed ") + out.count("started ") == 2
    assert read_tables(killed) == read_tables(whole)
    assert all(len(table.splitlines()) == 1 + 2 * 20 for table in read_tables(whole).values())
    code, out, _ = run_process("sweep", grid, "--out", killed, "--json")
    assert code == 0
    assert json.loads(out)["lines"][-1] == "2 runs: 2 done before, 0 done now, 0 failed"


FAILING = """
print("a stray line", flush=True)
if name == "c":
    emit("resumed", step=40)
    os.kill(os.getpid(), signal.SIGKILL)
if name == "d":
    emit("failed", why="ValueError: broken")
    sys.exit(1)
emit("done")
"""


def test_a_failed_group_is_reported_and_the_next_group_runs(grid, tmp_path, workers, capsys):
    workers(FAILING, ["ab", "c", "d", "e"])
    with pytest.raises(SystemExit) as exit_info:
        cli.main(["sweep", str(grid), "--out", str(tmp_path)])
    assert exit_info.value.code == 1
    printed = capsys.readouterr()
    assert printed.out.splitlines() == [
        "done       z  (before)",
        "done       a",
        "failed     b  the worker ended with code 0",
        "resumed    c  from step 40",
        "failed     c  the worker was ended by signal 9",
        "failed     d  ValueError: broken",
        "done       e",
        "6 runs: 1 done before, 2 done now, 3 failed",
    ]
    assert printed.err.count("a stray line") == 4


def test_a_sweep_whose_minutes_run_out_starts_no_other_group(grid, tmp_path, workers, monkeypatch, capsys):
    workers('emit("started")\nemit("stopped", step=task["limit"][1])\n', "ab")
    clock = itertools.chain([1000.0, 1000.0], itertools.repeat(1200.0))
    lines = []
    with monkeypatch.context() as patch:
        patch.setattr("earl_jax.options.time", SimpleNamespace(time=lambda: next(clock)))
        assert launcher.sweep(grid, tmp_path, emit=lines.append, minutes=2) == (0, ("a", "b"))
    assert lines[1:] == [
        "started    a",
        "stopped    a  at step 1120.0",
        "3 runs: 1 done before, 0 done now, 0 failed, 2 unfinished after 2 minutes; repeat the command to continue",
    ]
    cli.main(["sweep", str(grid), "--out", str(tmp_path), "--minutes", "1e-9", "--json"])
    printed = json.loads(capsys.readouterr().out)
    assert (printed["failed"], printed["stopped"], printed["unfinished"]) == (0, True, ["a", "b"])


TOGETHER = """
deadline = time.monotonic() + 30
while len(list(folder.glob("[a-z]"))) < COUNT and time.monotonic() < deadline:
    time.sleep(0.005)
if name == "b":
    os.kill(os.getpid(), signal.SIGKILL)
"""
RECORD = """
variables = {key: value for key, value in os.environ.items() if key.startswith(("CUDA", "JAX_PL", "XLA", "EARL"))}
(folder / (name + ".json")).write_text(json.dumps({"cores": task["cores"], "progress": task["progress"], **variables}))
emit("done")
"""


def read_records(folder):
    """Return the record of every worker that finished, by the name of its run."""
    return {path.stem: json.loads(path.read_text()) for path in sorted(folder.glob("*.json"))}


def test_programs_share_gpus_through_mps_and_one_that_fails_costs_its_runs_only(gpus, grid, workers, tmp_path):
    folder, lines = workers(TOGETHER.replace("COUNT", "4") + RECORD, "abcde"), []
    assert launcher.sweep(grid, tmp_path / "out", per_device=2, emit=lines.append).failed == 1
    how = "through the MPS daemon started for them"
    assert lines[1] == f"2 programs at a time on each of 2 GPUs, 2 cores each {how}"
    assert lines[-1] == "6 runs: 1 done before, 4 done now, 1 failed"
    assert "failed     b  the worker was ended by signal 9" in lines
    records = read_records(folder)
    assert list(records) == ["a", "c", "d", "e"]
    assert gpus.log == ["start devices=", "quit"]
    first = records["a"], records["c"], records["d"]
    assert {record["CUDA_VISIBLE_DEVICES"] for record in first} == {"0", "1"}
    assert len({tuple(record["cores"]) for record in first}) == 3
    for record in records.values():
        assert record["XLA_PYTHON_CLIENT_MEM_FRACTION"] == "0.4600"
        assert record["EARL_JAX_PER_DEVICE"] == "2"
        assert record["CUDA_MPS_PIPE_DIRECTORY"].endswith("/pipe")
        assert record["progress"] is False


ONE = "1 program at a time on each of 2 GPUs, 4 cores each"


@pytest.mark.parametrize(
    ("mps", "per_device", "groups", "line", "log"),
    [
        ("broken", 4, "abcd", f"{ONE}; MPS cannot be used: MPS is not supported here", ["start devices="]),
        (
            "running",
            2,
            "abcd",
            "2 programs at a time on each of 2 GPUs, 2 cores each through the running MPS daemon",
            [],
        ),
        ("unused", 3, "ab", ONE, []),
        ("unused", "auto", "abcd", ONE, []),
        (
            "measured",
            "auto",
            "abcd",
            "2 programs at a time on each of 2 GPUs, 2 cores each through the MPS daemon started for them",
            ["start devices=", "quit"],
        ),
        ("on a CPU", 2, "ac", "2 programs at a time, 4 cores each", []),
        ("on a CPU", "auto", "ac", "1 program at a time, 8 cores each", []),
    ],
)
def test_slots_depend_on_mps_and_on_the_number_of_programs(
    gpus, grid, workers, tmp_path, monkeypatch, mps, per_device, groups, line, log
):
    {"broken": gpus.break_mps, "running": gpus.run_daemon}.get(mps, lambda: None)()
    monkeypatch.setattr(slots, "GAINS", {"sawyer_door": {(2, 2): 1.8}} if mps == "measured" else {})
    if mps == "on a CPU":
        monkeypatch.setenv("JAX_PLATFORMS", "cpu")
    folder, lines = workers(RECORD, groups), []
    launcher.sweep(grid, tmp_path / "out", per_device=per_device, emit=lines.append)
    assert lines[1] == line
    assert lines[-1].endswith(f"{len(groups)} done now, 0 failed")
    records = read_records(folder)
    assert {len(record["cores"]) for record in records.values()} == {int(line.partition(" core")[0].split()[-1])}
    assert {"CUDA_MPS_PIPE_DIRECTORY" in record for record in records.values()} == {mps == "measured"}
    assert all(record["progress"] is (per_device == "auto" and mps == "on a CPU") for record in records.values())
    assert gpus.log == log


SAVE = """
def save_and_end(number, frame):
    os.write(2, f"saved {name}\\n".encode())
    sys.exit(128 + number)
signal.signal(signal.SIGTERM, HANDLER)
emit("started")
time.sleep(60)
"""


@pytest.mark.parametrize(("per_device", "started"), [(None, "a"), (2, "abcd")])
def test_a_signal_reaches_all_workers_and_no_other_group_starts(
    gpus, grid, workers, tmp_path, capfd, per_device, started
):
    workers(SAVE.replace("HANDLER", "save_and_end"), "abcde")
    lines = []

    def emit(line):
        lines.append(line)
        if line.startswith("started") and sum(line.startswith("started") for line in lines) == len(started):
            os.kill(os.getpid(), signal.SIGTERM)

    with pytest.raises(SystemExit) as exit_info:
        launcher.sweep(grid, tmp_path / "out", per_device=per_device, emit=emit)
    assert exit_info.value.code == 128 + signal.SIGTERM
    assert sorted(line for line in lines if line.startswith("stopped  ")) == [
        f"stopped    {name}  the worker ended with code 143" for name in started
    ]
    assert lines[-1] == "stopped; repeat the command to continue"
    assert sorted(capfd.readouterr().err.splitlines()) == [f"saved {name}" for name in started]
    assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL
    assert gpus.log == ([] if per_device is None else ["start devices=", "quit"])


@pytest.mark.parametrize(("end", "handler"), [("error", "save_and_end"), ("second signal", "signal.SIG_IGN")])
def test_a_second_signal_or_an_error_ends_all_workers_and_the_daemon(
    gpus, grid, workers, tmp_path, monkeypatch, capfd, end, handler
):
    folder, started = workers(SAVE.replace("HANDLER", handler)), []
    monkeypatch.setattr(processes, "PATIENCE", 30 if handler == "save_and_end" else 0.1)

    def emit(line):
        started.extend([line] * line.startswith("started"))
        if len(started) == 4:
            if end == "error":
                raise BrokenPipeError
            for _ in range(2):
                os.kill(os.getpid(), signal.SIGTERM)

    with pytest.raises((SystemExit, BrokenPipeError)):
        launcher.sweep(grid, tmp_path / "out", per_device=2, emit=emit)
    for path in folder.iterdir():
        with pytest.raises(ProcessLookupError):
            os.kill(int(path.read_text()), 0)
    assert capfd.readouterr().err.count("saved") == (4 if handler == "save_and_end" else 0)
    assert gpus.log == ["start devices=", "quit"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"per_device": 0}, "must be auto, or a number from 1 to 48, not 0"),
        ({"per_device": 2, "devices": 2}, "choose one of them"),
        ({"per_device": 2, "launcher": "slurm"}, "--per-device goes with --launcher local"),
        ({"launcher": "slurm", "slurm": ("time=5",), "minutes": 5}, "--slurm time=MINUTES limits each job"),
        ({"launcher": "cloud"}, "choose from local, slurm"),
        ({"slurm": ("time=5",)}, "--slurm options go with --launcher slurm"),
    ],
)
def test_options_that_exclude_each_other_are_refused_before_anything_starts(grid, workers, tmp_path, options, message):
    folder = workers(RECORD)
    with pytest.raises(ValueError, match=message):
        launcher.sweep(grid, tmp_path / "out", **options)
    assert not list(folder.iterdir())
