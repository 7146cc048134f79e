"""Tests of the worker: runs that share a program give the results that each gives alone, in separate folders."""

import contextlib
import io
import json
import os
import shutil
import signal
import subprocess
import sys
import time

import pytest

from earl_jax.algos import method_for
from earl_jax.envs import make
from earl_jax.runs.folder import RunFolder
from earl_jax.sweeps import __main__ as process
from earl_jax.sweeps import planner, worker
from earl_jax.training import load_lanes, runner, train
from tests.conftest import TINY, assert_equal_trees
from tests.sweeps.conftest import LENGTHS, NAMES


@pytest.fixture(scope="module")
def separate_folders(tmp_path_factory):
    """Folders of the two runs of the grid, each trained in a program of its own."""
    parent = tmp_path_factory.mktemp("separate")
    env = make("tabletop_organization", eval_horizon=30)  # so short that the oracle is reset within the run
    for scale in (1, 10):
        train(env, method_for(env, "oracle", **TINY, reward_scale=scale), out=parent / str(scale), **LENGTHS)
    return [parent / str(scale) for scale in (1, 10)]


def work(plan, out):
    """Return whether the runs of `plan` succeeded, and the events of the worker."""
    events = []
    configs = {name: worker.parse_config(run["config"]) for name, run in plan["runs"].items()}
    succeeded = worker.work(
        out, configs, lambda name, state, **details: events.append((name, state, details)), progress=False
    )
    return succeeded, events


def assert_equal_runs(out, separate_folders):
    for name, folder in zip(NAMES, separate_folders, strict=True):
        assert (out / name / "metrics.csv").read_bytes() == (folder / "metrics.csv").read_bytes()
        actual, expected = (load_lanes(RunFolder.open(path))[2] for path in (out / name, folder))
        assert_equal_trees(actual, expected)


def test_two_runs_in_one_program_equal_separate_runs(tmp_path, grid, separate_folders):
    one, other = ((folder / "metrics.csv").read_text() for folder in separate_folders)
    assert one != other
    out = tmp_path / "out"
    plan = planner.plan(grid, out)
    assert [group["runs"] for group in plan["groups"]] == [NAMES]
    assert not out.exists()
    succeeded, events = work(plan, out)
    assert succeeded
    assert [state for _, state, _ in events] == ["started", "started", "done", "done"]
    assert_equal_runs(out, separate_folders)
    finished = planner.plan(grid, out)
    assert not finished["groups"]
    assert {run["step"] for run in finished["runs"].values()} == {120}
    assert work(finished, out) == (True, [(name, "done", {}) for name in NAMES])
    for name in NAMES:
        shutil.rmtree(out / name / "checkpoints")
    assert planner.plan(grid, out) == finished
    (out / NAMES[0] / "policies.npz").unlink()
    assert [group["runs"] for group in planner.plan(grid, out)["groups"]] == [NAMES[:1]]


def test_runs_stopped_at_different_checkpoints_continue_in_separate_programs(
    tmp_path, grid, separate_folders, monkeypatch
):
    save, saved_steps = runner.save, []

    def fail_at_fourth_save(folder, train_state, span):
        saved_steps.append(int(train_state.step))
        if len(saved_steps) == 4:
            raise OSError("no space left")
        return save(folder, train_state, span)

    monkeypatch.setattr(runner, "save", fail_at_fourth_save)
    out = tmp_path / "out"
    succeeded, events = work(planner.plan(grid, out), out)
    assert not succeeded
    assert saved_steps == [40, 40, 80, 80]
    assert events[-1] == (NAMES[1], "failed", {"why": "OSError: no space left"})
    monkeypatch.setattr(runner, "save", save)
    plan = planner.plan(grid, out)
    assert [(group["runs"], group["step"]) for group in plan["groups"]] == [(NAMES[:1], 80), (NAMES[1:], 40)]
    succeeded, events = work(plan, out)
    assert succeeded
    assert ("resumed", {"step": 80}) in [event[1:] for event in events]
    assert_equal_runs(out, separate_folders)


def test_runs_whose_minutes_run_out_continue_as_uninterrupted_ones(tmp_path, grid, separate_folders):
    out, configs = tmp_path / "out", {}
    for name, run in planner.plan(grid, out)["runs"].items():
        configs[name] = worker.parse_config(run["config"])

    class Limit:
        """Passes before the second group, or within the first one."""

        answers = iter([False, True])
        passed = property(lambda self: next(self.answers, True))

    events = []
    arguments = {"progress": False, "limit": Limit()}
    assert worker.work(out, configs, lambda name, state, **details: events.append((state, details)), **arguments)
    assert events == [("started", {"step": 0})] * 2 + [("stopped", {"step": 20})] * 2
    events.clear()
    assert worker.work(out, configs, lambda name, state, **details: events.append((state, details)), **arguments)
    assert events == [("stopped", {"step": 20})] * 2
    assert work(planner.plan(grid, out), out)[0]
    assert_equal_runs(out, separate_folders)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"config.json": "{}", "metrics.csv": "step,seed\n40,0\n"}, "config.json is damaged"),
        ({"thesis.tex": "all of it"}, "not an empty folder"),
        (None, "is in use by another process"),
    ],
)
def test_a_run_whose_folder_cannot_be_used_fails_with_its_cause(tmp_path, grid, capsys, content, message):
    fields = planner.plan(grid, tmp_path)["runs"][NAMES[0]]["config"]
    path = tmp_path / NAMES[0]
    with contextlib.ExitStack() as stack:
        if content is None:
            stack.enter_context(RunFolder.create(path, worker.parse_config(fields), "kinematic").claimed())
        else:
            path.mkdir(parents=True)
            for name, text in content.items():
                (path / name).write_text(text)
        assert worker.serve(json.dumps({"out": str(tmp_path), "runs": {NAMES[0]: fields}})) == 1
    event = json.loads(capsys.readouterr().out)
    assert (event["run"], event["state"]) == (NAMES[0], "failed")
    assert message in event["why"]
    assert content is None or (path / next(iter(content))).read_text() == next(iter(content.values()))


def test_a_worker_keeps_to_its_cores_and_its_progress(monkeypatch):
    calls = []
    monkeypatch.setattr(os, "sched_setaffinity", lambda pid, cores: calls.append((pid, cores)), raising=False)
    monkeypatch.setattr(sys, "stdin", io.StringIO('{"out": "", "runs": {}, "progress": false}'))
    monkeypatch.setattr(worker, "work", lambda *_, progress, **options: calls.append(progress) or True)
    assert process.main(["work", "--cores", "2", "3"]) == 0
    assert calls == [(0, [2, 3]), False]


BUSY = """
import re, sys
from earl_jax.sweeps.__main__ import end_with_pipe
end_with_pipe(0)
print("ready", flush=True)
re.match("(a*)*b", "a" * 40)  # takes years, and no other thread runs meanwhile
"""


@pytest.mark.skipif(sys.platform != "linux", reason="the system sends no SIGIO")
def test_a_worker_ends_with_its_launcher_in_code_that_holds_the_lock():
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-c", BUSY], **pipes) as busy:
        assert busy.stdout.readline() == b"ready\n"
        time.sleep(0.1)
        busy.stdin.close()
        assert busy.wait(timeout=10) == -signal.SIGIO


@pytest.mark.parametrize("command", [["work"], ["plan", "nowhere.toml", "--out", "out"]])
def test_a_worker_ends_with_its_launcher_while_it_imports(command):
    command = [sys.executable, "-m", "earl_jax.sweeps", *command, "--end-with-stdin"]
    with subprocess.Popen(command, stdin=subprocess.PIPE) as importing:
        os.write(importing.stdin.fileno(), b'{"out": "", "runs": {}}\n' if "work" in command else b"")
        time.sleep(0.5)
        began = time.monotonic()
        importing.stdin.close()
        assert importing.wait(timeout=10) != 0
    assert time.monotonic() - began < 2, "importing takes longer"
