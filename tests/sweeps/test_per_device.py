"""Sweeps with several programs at a time: where they run, one that fails, signals, and options that exclude each other."""

import io
import json
import os
import signal
import sys
from pathlib import Path

import pytest

from earl_jax.cli.main import main
from earl_jax.sweeps import __main__ as process
from earl_jax.sweeps import launcher, packing_rates, worker
from tests.report.run_files import read_csv

RESULTS = Path(__file__).parents[2] / "benchmarks/results/per_device"

WORKER = """
import json, os, signal, sys, time
from pathlib import Path
folder = Path({folder!r})
if sys.argv[1] == "plan":
    names = {names!r}
    groups = [{{"runs": [name], "lanes": 1, "step": 0, "steps": 40, "replay_bytes": 0}} for name in names]
    runs = {{name: {{"step": 0, "config": {{"env": "sawyer_door"}}}} for name in names}}
    print(json.dumps({{"out": sys.argv[4], "runs": runs, "groups": groups}}))
    sys.exit()
task = json.loads(sys.stdin.readline())
name = list(task["runs"])[0]
variables = {{key: value for key, value in os.environ.items() if key.startswith(("CUDA", "JAX_PL", "XLA", "EARL"))}}
cores = [int(core) for core in sys.argv[sys.argv.index("--cores") + 1:]]
record = {{"cores": cores, "progress": task["progress"], "started": time.monotonic(), **variables}}
emit = lambda state, **details: print(json.dumps({{"run": name, "state": state, **details}}), flush=True)
def save_and_end(number, frame):
    print("saved " + name, file=sys.stderr, flush=True)
    sys.exit(128 + number)
signal.signal(signal.SIGTERM, {handler})
(folder / name).write_text(str(os.getpid()))
emit("started")
{body}
(folder / (name + ".json")).write_text(json.dumps({{**record, "ended": time.monotonic()}}))
emit("done")
"""
TOGETHER = """
deadline = time.monotonic() + 30
while len(list(folder.glob("[a-z]"))) < {together} and time.monotonic() < deadline:
    time.sleep(0.005)
if name == "b":
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.fixture
def workers(tmp_path, monkeypatch):
    """A function that replaces the worker of sweeps by a script, and returns the folder of its records and its sweep."""
    folder, grid = tmp_path / "records", tmp_path / "grid.toml"
    folder.mkdir()
    grid.write_text("")

    def replace(body, names="abcd", handler="save_and_end"):
        script = tmp_path / "worker.py"
        script.write_text(WORKER.format(folder=str(folder), names=names, body=body, handler=handler))
        monkeypatch.setattr(launcher, "WORKER", [sys.executable, str(script)])
        return folder, grid

    return replace


def read_records(folder):
    """Return the record of every worker that finished, by the name of its run."""
    return {path.stem: json.loads(path.read_text()) for path in sorted(folder.glob("*.json"))}


def test_programs_share_gpus_through_mps_and_one_that_fails_costs_its_runs_only(gpus, workers, tmp_path, capsys):
    folder, grid = workers(TOGETHER.format(together=4), "abcde")
    with pytest.raises(SystemExit) as exit_info:
        main(["sweep", str(grid), "--out", str(tmp_path / "out"), "--per-device", "2"])
    assert exit_info.value.code == 1
    lines = capsys.readouterr().out.splitlines()
    how = "through the MPS daemon started for them"
    assert lines[0] == f"2 programs at a time on each of 2 GPUs, 2 cores each {how}"
    assert lines[-1] == "5 runs: 0 done before, 4 done now, 1 failed"
    assert "failed     b  the worker was ended by signal 9" in lines
    records = read_records(folder)
    assert list(records) == ["a", "c", "d", "e"]
    assert gpus.log == ["start devices=", "quit"]
    first = records["a"], records["c"], records["d"]
    assert max(record["started"] for record in first) < min(record["ended"] for record in first)
    assert {record["CUDA_VISIBLE_DEVICES"] for record in first} == {"0", "1"}
    assert len({tuple(record["cores"]) for record in first}) == 3
    assert all(len(record["cores"]) == 2 for record in records.values())
    for record in records.values():
        assert record["XLA_PYTHON_CLIENT_MEM_FRACTION"] == "0.4600"
        assert record["EARL_JAX_PER_DEVICE"] == "2"
        assert record["CUDA_MPS_PIPE_DIRECTORY"].endswith("/pipe")
        assert record["progress"] is False


def test_without_mps_each_gpu_has_one_program(gpus, workers, tmp_path):
    gpus.break_mps()
    folder, grid = workers("")
    lines = []
    launcher.sweep(grid, tmp_path / "out", per_device=4, emit=lines.append)
    assert lines[-1].endswith("4 done now, 0 failed")
    cause = "MPS cannot be used: MPS is not supported here"
    assert lines[0] == f"1 program at a time on each of 2 GPUs, 4 cores each; {cause}"
    assert {len(record["cores"]) for record in read_records(folder).values()} == {4}
    assert gpus.log == ["start devices="]


def test_a_running_daemon_serves_the_workers(gpus, workers, tmp_path):
    gpus.run_daemon()
    folder, grid = workers("")
    lines = []
    launcher.sweep(grid, tmp_path / "out", per_device=2, emit=lines.append)
    assert lines[0].endswith("2 cores each through the running MPS daemon")
    assert all("CUDA_MPS_PIPE_DIRECTORY" not in record for record in read_records(folder).values())
    assert gpus.log == []


def test_one_program_for_each_gpu_needs_no_mps(gpus, workers, tmp_path):
    folder, grid = workers("", "ab")
    lines = []
    launcher.sweep(grid, tmp_path / "out", per_device=3, emit=lines.append)
    assert lines[0] == "1 program at a time on each of 2 GPUs, 4 cores each"
    assert {record["CUDA_VISIBLE_DEVICES"] for record in read_records(folder).values()} == {"0", "1"}
    assert gpus.log == []


def test_programs_share_the_cores_of_a_machine_without_a_gpu(gpus, workers, tmp_path, monkeypatch):
    monkeypatch.setenv("JAX_PLATFORMS", "cpu")
    folder, grid = workers(TOGETHER.format(together=2), "ac")
    lines = []
    launcher.sweep(grid, tmp_path / "out", per_device=2, emit=lines.append)
    assert lines[-1].endswith("2 done now, 0 failed")
    assert lines[0] == "2 programs at a time, 4 cores each"
    records = read_records(folder)
    assert sorted(record["cores"] for record in records.values()) == [[0, 1, 2, 3], [4, 5, 6, 7]]
    assert {record["JAX_PLATFORMS"] for record in records.values()} == {"cpu"}
    lines.clear()
    launcher.sweep(grid, tmp_path / "out", per_device="auto", emit=lines.append)
    assert lines[0] == "1 program at a time, 8 cores each"
    assert gpus.log == []


SLEEP = "time.sleep(60)"


def test_a_signal_reaches_all_workers_and_the_daemon_ends(gpus, workers, tmp_path, capsys):
    _, grid = workers(SLEEP)
    lines = []

    def emit(line):
        lines.append(line)
        if sum(line.startswith("started") for line in lines) == 4 and "sent" not in lines:
            lines.append("sent")
            os.kill(os.getpid(), signal.SIGTERM)

    with pytest.raises(SystemExit) as exit_info:
        launcher.sweep(grid, tmp_path / "out", per_device=2, emit=emit)
    assert exit_info.value.code == 128 + signal.SIGTERM
    assert sorted(line for line in lines if line.startswith("stopped  ")) == [
        f"stopped    {name}  the worker ended with code 143" for name in "abcd"
    ]
    assert lines[-1] == "stopped; repeat the command to continue"
    assert sorted(capsys.readouterr().err.split("\n")[:-1]) == [f"saved {name}" for name in "abcd"]
    assert gpus.log == ["start devices=", "quit"]


@pytest.mark.parametrize("end", ["second signal", "error"])
def test_a_second_signal_or_an_error_ends_all_workers_and_the_daemon(gpus, workers, tmp_path, end):
    folder, grid = workers(SLEEP, handler="signal.SIG_IGN")
    started = []

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
    assert gpus.log == ["start devices=", "quit"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"per_device": 0}, "must be auto, or a number from 1 to 48, not 0"),
        ({"per_device": 2, "devices": 2}, "choose one of them"),
        ({"per_device": 2, "launcher": "slurm"}, "--per-device goes with --launcher local"),
    ],
)
def test_options_that_exclude_each_other_are_refused_before_anything_starts(workers, tmp_path, options, message):
    folder, grid = workers("")
    with pytest.raises(ValueError, match=message):
        launcher.sweep(grid, tmp_path / "out", **options)
    assert not list(folder.iterdir())


def test_auto_takes_the_largest_gain_for_the_cores(monkeypatch):
    gains = {"quick": {(2, 8): 1.8, (4, 4): 2.4}, "full": {(2, 8): 1.0}}
    monkeypatch.setattr(packing_rates, "GAINS", gains)
    programs = packing_rates.measured_programs
    assert [programs(["quick"], cores) for cores in (32, 16, 15, 8)] == [4, 4, 1, 1]
    assert programs(["full"], 16) == 1, "two programs gain nothing"
    assert programs(["quick", "full"], 16) == programs(["quick", "unmeasured"], 16) == programs([], 16) == 1


def test_auto_takes_the_measured_number_of_the_tasks_of_a_sweep(gpus, workers, tmp_path, monkeypatch):
    monkeypatch.setattr(packing_rates, "GAINS", {"sawyer_door": {(2, 2): 1.8}})
    _, grid = workers("")
    lines = []
    launcher.sweep(grid, tmp_path / "out", per_device="auto", emit=lines.append)
    assert lines[0].startswith("2 programs at a time on each of 2 GPUs, 2 cores each")
    assert gpus.log == ["start devices=", "quit"]


def test_the_table_of_auto_is_the_committed_measurement():
    measured = {}
    for path in RESULTS.glob("*.csv"):
        for row in read_csv(path):
            if row["programs"] != "1":
                key = int(row["programs"]), int(row["cores_each"])
                measured.setdefault(row["env"], {})[key] = float(row["wall_gain"])
    assert measured == packing_rates.GAINS


def test_a_worker_keeps_to_its_cores_and_its_progress(monkeypatch):
    calls = []
    monkeypatch.setattr(os, "sched_setaffinity", lambda pid, cores: calls.append((pid, cores)), raising=False)
    monkeypatch.setattr(sys, "stdin", io.StringIO('{"out": "", "runs": {}, "progress": false}'))
    monkeypatch.setattr(worker, "work", lambda *_, progress, **options: calls.append(progress) or True)
    assert process.main(["work", "--cores", "2", "3"]) == 0
    assert calls == [(0, [2, 3]), False]
