"""Tests of the launcher on this machine: no jax, reported failures, signals, minutes, kills, and several workers at a time."""

import itertools
import json
import os
import signal
import subprocess
import sys
from types import SimpleNamespace
from unittest.mock import Mock

import pytest

from earl_jax.options.environment import PYTHON
from earl_jax.sweeps import launcher, processes
from tests.cli.process import ENVIRONMENT, one_line, run, run_process, start, succeed, wait_until
from tests.conftest import write_mine
from tests.sweeps.conftest import GRID, read_tables

PLAN = """
import sys, earl_jax.sweeps.launcher
from earl_jax.cli import main
main(["sweep", "/dev/stdin", "--out", "out", "--dry-run", "--import", "mine.py"])
assert not {"jax", "numpy", "flax", "mujoco"} & set(sys.modules), sorted(sys.modules)
"""


def test_a_grid_at_stdin_is_planned_without_jax_in_the_launcher_or_a_module_of_the_folder(tmp_path):
    """The worker has another pipe at /dev/stdin, and used to wait for its end."""
    write_mine(tmp_path)
    (tmp_path / "json.py").write_text("raise RuntimeError")
    given = {"input": GRID.replace("oracle", "patient"), "env": ENVIRONMENT, "cwd": tmp_path}
    printed = subprocess.check_output([*PYTHON, "-c", PLAN], text=True, timeout=300, **given)
    assert "program 1: 4 lanes, steps 0 to 120, replay" in printed
    assert "2 runs, 0 of them done; programs to run: 1" in printed
    assert not (tmp_path / "out").exists()


def test_a_grid_at_stdin_from_a_file_is_planned_by_its_name(grid, monkeypatch):
    monkeypatch.setattr(launcher, "start", planner := Mock(side_effect=ZeroDivisionError))
    with grid.open() as file, pytest.raises(ZeroDivisionError):
        launcher.plan_sweep(f"/dev/fd/{file.fileno()}", grid.parent)
    assert planner.call_args.args[0]["grid"] == str(grid)


@pytest.mark.slow
def test_a_sweep_of_an_own_method_continues_after_a_kill_and_loses_nothing(grid, tmp_path):
    write_mine(tmp_path)
    grid.write_text('import = ["mine.py"]\n' + GRID.replace("steps = 120", "steps = 800").replace("oracle", "patient"))
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    out = succeed("sweep", grid, "--out", whole, by=run_process)
    assert "2 runs: 0 done before, 2 done now, 0 failed" in out
    process = start("sweep", grid, "--out", killed)
    assert wait_until(lambda: list(killed.glob("*/*/*/checkpoints/0*")))
    process.send_signal(signal.SIGKILL)  # only the launcher, so that its worker must notice
    process.communicate()
    assert read_tables(killed) != read_tables(whole)
    out = succeed("sweep", grid, "--out", killed, by=run_process)
    assert out.count("resumed ") + out.count("started ") == 2
    assert read_tables(killed) == read_tables(whole)
    assert all(len(table.splitlines()) == 1 + 2 * 20 for table in read_tables(whole).values())


def test_an_event_is_one_write_so_that_no_other_thread_can_print_into_it(monkeypatch):
    written = []
    monkeypatch.setattr(sys, "stdout", SimpleNamespace(write=written.append, flush=lambda: None))
    processes.report(state="refused", detail="why")
    assert list(filter(None, written)) == ['\x1e{"state": "refused", "detail": "why"}\n']


FAILING = """
print("a stray line", '{"state": "stray"} without an end', sep=os.linesep, end="", flush=True)
if name == "c":
    emit("resumed", "from step 40")
    os.kill(os.getpid(), signal.SIGKILL)
if name == "d":
    emit("failed", "ValueError: broken")
    sys.exit(1)
emit("done")
"""


def test_a_failed_group_is_reported_and_the_next_group_runs(grid, tmp_path, workers):
    workers(FAILING, ["ab", "c", "d", "e"])
    code, out, err = run("sweep", grid, "--out", tmp_path)
    assert code == 1
    assert out.splitlines() == [
        "done       z  (before)",
        "done       a",
        "failed     b  the worker ended with code 0",
        "resumed    c  from step 40",
        "failed     c  the worker was ended by signal 9",
        "failed     d  ValueError: broken",
        "done       e",
        "6 runs: 1 done before, 2 done now, 3 failed",
    ]
    assert err.count('a stray line\n{"state": "stray"} without an end') == 4
    values = json.loads(run("sweep", grid, "--out", tmp_path, "--json")[1])
    states = {run["folder"]: (run["state"], run["detail"]) for run in values["runs"]}
    assert states[f"{tmp_path}/z"] == ("done", "before")
    assert states[f"{tmp_path}/d"] == ("failed", "ValueError: broken")
    assert (len(states), values["failed"], values["stopped"]) == (6, 3, False)


def test_a_sweep_whose_minutes_run_out_starts_no_other_group(grid, tmp_path, workers, monkeypatch):
    workers('emit("started", str(task["progress"]))\nemit("stopped", str(task["limit"][1]))\n', "ab")
    clock = itertools.chain([1000.0, 1000.0], itertools.repeat(1200.0))
    lines = []
    with monkeypatch.context() as patch:
        patch.setattr("earl_jax.options.values.time", SimpleNamespace(monotonic=lambda: next(clock)))
        outcome = launcher.sweep(grid, tmp_path, emit=lines.append, minutes=2)
    assert (outcome.failed, outcome.unfinished) == ((), ("a", "b"))
    assert lines[1:] == [
        "started    a  True",
        "stopped    a  1120.0",
        "3 runs: 1 done before, 0 done now, 0 failed, 2 unfinished after 2 minutes; repeat the command to continue",
    ]
    printed = json.loads(succeed("sweep", grid, "--out", tmp_path, "--minutes", "1e-9", "--json"))
    assert (printed["failed"], printed["stopped"], printed["unfinished"]) == (0, True, ["a", "b"])


SHARING = """
deadline = time.monotonic() + 30
while len(list(folder.glob("[a-z]"))) < 4 and time.monotonic() < deadline:
    time.sleep(0.005)
if name == "b":
    os.kill(os.getpid(), signal.SIGKILL)
variables = {key: value for key, value in os.environ.items() if key.startswith(("CUDA", "JAX_PL", "XLA", "EARL"))}
(folder / (name + ".json")).write_text(json.dumps({"cores": task["cores"], "progress": task["progress"], **variables}))
emit("done")
"""
STARTED = "start devices=\nquit\n"


def test_programs_share_gpus_through_mps_and_one_that_fails_costs_its_runs_only(gpus, grid, workers, tmp_path):
    folder, lines = workers(SHARING, "abcde"), []
    assert launcher.sweep(grid, tmp_path / "out", per_device=2, emit=lines.append).failed == ("b",)
    assert lines[1] == "2 programs at a time on each of 2 GPUs, 2 cores each through the MPS daemon started for them"
    assert lines[-1] == "6 runs: 1 done before, 4 done now, 1 failed"
    assert "failed     b  the worker was ended by signal 9" in lines
    assert (gpus / "log").read_text() == STARTED
    records = {path.stem: json.loads(path.read_text()) for path in sorted(folder.glob("*.json"))}
    assert list(records) == ["a", "c", "d", "e"]
    assert {records[name]["CUDA_VISIBLE_DEVICES"] for name in "acd"} == {"0", "1"}
    assert len({tuple(records[name]["cores"]) for name in "acd"}) == 3
    expected = {"XLA_PYTHON_CLIENT_MEM_FRACTION": "0.4600", "EARL_JAX_PER_DEVICE": "2", "progress": False}
    for record in records.values():
        assert record.items() >= expected.items()
        assert record["CUDA_MPS_PIPE_DIRECTORY"].endswith("/pipe")


SAVE = """
def save_and_end(number, frame):
    os.write(2, f"saved {name}\\n".encode())
    sys.exit(128 + number)
signal.signal(signal.SIGTERM, HANDLER)
emit("started")
for _ in range(600):
    time.sleep(0.1)  # a longer sleep misses a signal that arrives just before it
"""


@pytest.mark.parametrize(("end", "per_device"), [("signal", None), ("signal", 2), ("error", 2), ("second signal", 2)])
def test_a_signal_or_an_error_ends_all_workers(gpus, grid, workers, tmp_path, monkeypatch, capfd, end, per_device):
    """A worker that ignores the first signal is ended by the second one."""
    saves = end != "second signal"
    body = SAVE.replace("HANDLER", "save_and_end" if saves else "signal.SIG_IGN")
    folder, lines, names = workers(body, "abcde"), [], "abcd" if per_device else "a"
    monkeypatch.setattr(processes, "PATIENCE", 30 if saves else 0.1)

    def emit(line):
        lines.append(line)
        if line.startswith("started") and sum(line.startswith("started") for line in lines) == len(names):
            if end == "error":
                raise BrokenPipeError
            for _ in range(1 if saves else 2):
                os.kill(os.getpid(), signal.SIGTERM)

    with pytest.raises(BrokenPipeError if end == "error" else SystemExit) as exit_info:
        launcher.sweep(grid, tmp_path / "out", per_device=per_device, emit=emit)
    assert end == "error" or exit_info.value.code == 128 + signal.SIGTERM
    if end == "signal":
        stopped = [f"stopped    {name}  the worker ended with code 143" for name in names]
        assert sorted(line for line in lines if line.startswith("stopped  ")) == stopped
        assert lines[-1] == "stopped; repeat the command to continue"
    ended = ["earl-jax: ended by a second signal; repeat the command to continue"]
    assert sorted(capfd.readouterr().err.splitlines()) == ([f"saved {name}" for name in names] if saves else ended)
    assert sorted(path.name for path in folder.iterdir()) == list(names)
    for path in folder.iterdir():
        with pytest.raises(ProcessLookupError):
            os.kill(int(path.read_text()), 0)
    assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL
    assert (gpus / "log").read_text() == (STARTED if per_device else "")


def test_a_sweep_that_a_signal_stops_prints_its_json(grid, workers, tmp_path):
    done = 'if name == "a":\n    emit("done")\n    sys.exit()\n'
    body = SAVE.replace("HANDLER", "save_and_end").replace('emit("started")', "os.kill(os.getppid(), signal.SIGTERM)")
    workers(done + body, "abc")
    code, out, _ = run("sweep", grid, "--out", tmp_path / "out", "--json")
    values = json.loads(out)
    assert (code, values["failed"], values["stopped"]) == (128 + signal.SIGTERM, 0, True)
    assert (values["unfinished"], values["lines"][-1]) == (["b", "c"], "stopped; repeat the command to continue")


def test_a_worker_that_cannot_start_ends_the_sweep_with_the_error(grid, workers, tmp_path, monkeypatch):
    workers("", "ab")
    with pytest.raises(FileNotFoundError, match="missing"):
        launcher.sweep(grid, tmp_path / "out", emit=lambda line: monkeypatch.setattr(processes, "WORKER", ["missing"]))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"per_device": 0}, "must be auto, or a number from 1 to 48, not 0"),
        ({"per_device": "many"}, "must be auto, or a number from 1 to 48, not many"),
        ({"per_device": True}, "must be auto, or a number from 1 to 48, not True"),
        ({"per_device": 2.0}, "must be auto, or a number from 1 to 48, not 2.0"),
        ({"devices": 0}, "devices must lie in .1, 2147483647., not 0"),
        ({"max_lanes": 0}, "max_lanes must lie in .1, 2147483647., not 0"),
        ({"per_device": 2, "devices": 2}, "choose one of them"),
        ({"per_device": 2, "launcher": "slurm"}, "--per-device goes with --launcher local"),
        ({"launcher": "slurm", "slurm": ("time=5",), "minutes": 5}, "time=MINUTES limits each job"),
        ({"launcher": "slurm", "slurm": ("open_mode=truncate",)}, "--slurm open_mode: the launcher sets it"),
        ({"slurm": ("time=5",)}, "--slurm options go with --launcher slurm"),
    ],
)
def test_options_that_a_sweep_cannot_have_are_refused_before_anything_starts(grid, workers, tmp_path, options, message):
    folder = workers("")
    with pytest.raises(ValueError, match=message):
        launcher.sweep(grid, tmp_path / "out", **options)
    assert not list(folder.iterdir())


def test_a_grid_that_the_planner_refuses_is_refused_in_its_words(grid, tmp_path, monkeypatch):
    refuse = "from earl_jax.sweeps.processes import report; report(state='refused', detail='why')"
    monkeypatch.setattr(processes, "WORKER", [sys.executable, "-c", refuse])
    one_line(run("sweep", grid, "--out", tmp_path / "out"), "earl-jax: why")


def test_a_dry_run_refuses_what_the_sweep_refuses(grid, tmp_path):
    one_line(run("sweep", grid, "--out", tmp_path / "out", "--dry-run", "--per-device", "0"), "must be auto")
