"""The worker: the programs of a grid, and runs that share one but give the results that each gives alone, in separate folders."""

import contextlib
import hashlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time

import jax
import numpy as np
import pytest

from earl_jax.envs import make
from earl_jax.runs.config import RunConfig
from earl_jax.runs.folder import RunFolder
from earl_jax.sweeps import __main__ as process, worker
from earl_jax.sweeps.processes import MARK
from earl_jax.training import load_lanes, memory, runner
from tests.cli.process import unchanged
from tests.conftest import MINE, assert_equal_trees, tiny_method, tiny_train, write_mine
from tests.sweeps.conftest import GRID, NAMES

LAYER_NORM = GRID.replace('"oracle"', '"naive", "oracle"') + "layer_norm = [true, false]\n"


@pytest.mark.parametrize(
    ("text", "max_lanes", "programs"),
    [
        (GRID, None, [(4, 120)]),
        (LAYER_NORM, None, [(4, 120)] * 4),
        (LAYER_NORM, 3, [(2, 120)] * 8),
        (GRID + 'eval_pairs = ["random", "balanced"]\n', None, [(4, 120)] * 2),
        (GRID + "train_horizon = [0, 1000]\nintervention_chance = [0, 1]\n", None, [(16, 120)]),
        (
            f"{GRID}[[runs]]\noptions = {{ wide = true }}\n[[runs]]\nsteps = 240\noptions.reward_scale = 1\n",
            None,
            [(2, 240), (2, 120), (4, 120)],
        ),
    ],
)
def test_a_program_has_the_runs_of_one_task_method_and_length(tmp_path, grid, text, max_lanes, programs):
    """Lanes carry horizons and floats as data; a layer norm is compiled. `programs` are pairs of lanes and steps."""
    grid.write_text(text)
    plan = worker.plan(grid, tmp_path, max_lanes)
    assert [(group["lanes"], group["steps"]) for group in plan["groups"]] == programs
    for group in plan["groups"]:
        assert len({("naive" in name, "layer_norm=true" in name) for name in group["runs"]}) == 1


def test_the_replay_of_a_program_is_that_of_all_its_lanes(tmp_path, grid, problem):
    [group] = worker.plan(grid, tmp_path)["groups"]
    assert group["replay_bytes"] == 4 * memory.replay_bytes(problem, tiny_method("oracle"), 120)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("oracle", "ppo"), "unknown method 'ppo'; choose from .*vaprl"),
        (("tabletop_organization", "../../x"), "unknown task '../../x'; choose from cheetah_run"),
        (("batch_size", "bath_size"), "tabletop_organization/oracle/bath_size=16,.* 'bath_size'; did you mean batch_size"),
        (("steps = 120", "steps = 100"), "steps 100 is not a multiple of eval_every 40"),
        (('tabletop_organization"]\nalgos = ["oracle', 'fish_swim"]\nalgos = ["vaprl'), "vaprl needs demonstrations"),
        ({"grid": "nowhere.toml"}, "nowhere.toml can't be read"),
        ({"max_lanes": 1}, "has 2 seeds, more than 1 lane;"),
        ({"logs": ["tensorbord"]}, r"unknown log 'tensorbord'; did you mean 'tensorboard'\? Choose from tensorboard, wandb"),
        ({"logs": "wandb"}, "logs must be a list"),
        ({"out": "gs://a/out"}, "gs:/a/out is an address"),
        ({"out": __file__}, f"{__file__} exists, but is not a folder"),
        ({"out": f"{__file__}/runs"}, f"{__file__} exists, but is not a folder"),
    ],
)  # fmt: skip
def test_runs_logs_and_folders_that_are_invalid_are_refused_in_one_line(tmp_path, grid, change, message, capsys):
    task = {"grid": str(grid), "out": str(tmp_path / "out"), "max_lanes": None}
    if isinstance(change, dict):
        task |= change
    else:
        grid.write_text(GRID.replace(*change))
    process.serve(task)
    printed = capsys.readouterr()
    event = json.loads(printed.out.strip(MARK))
    assert event["state"] == "refused"
    assert re.search(message, event["detail"])
    assert (printed.err, len(event["detail"].splitlines())) == ("", 1)
    assert not (tmp_path / "out").exists()


def test_folder_of_another_run_is_refused_and_stays_unchanged(tmp_path, grid):
    config = RunConfig(**worker.plan(grid, tmp_path)["groups"][0]["runs"][NAMES[0]])
    folder = RunFolder.create(tmp_path / NAMES[0], config, "kinematic")
    with folder.claimed():
        folder.append(40, {"deployed/success": np.zeros(2)})
    assert list(worker.plan(grid, tmp_path)["groups"][0]["runs"]) == NAMES
    grid.write_text(GRID.replace("steps = 120", "steps = 240").replace("seeds = 2", "seeds = 3"))
    differences = r"seeds \[0, 1\] there, \[0, 1, 2\] here; steps 120 there, 240 here.*another --out"
    with unchanged(folder.path), pytest.raises(ValueError, match=differences):
        worker.plan(grid, tmp_path)
    grid.write_text(GRID.replace("steps = 120", "steps = 80"))
    with unchanged(folder.path), pytest.raises(ValueError, match=r"steps 120 there, 80 here"):
        worker.plan(grid, tmp_path)


@pytest.fixture(scope="module")
def separate_folders(tmp_path_factory):
    """Folders of the two runs of the grid, each trained in a program of its own."""
    parent = tmp_path_factory.mktemp("separate")
    env = make("tabletop_organization", eval_horizon=30)  # so short that the oracle is reset within the run
    for scale in (1, 10):
        tiny_train("oracle", env, reward_scale=scale, checkpoint_every=40, out=parent / str(scale))
    return [parent / str(scale) for scale in (1, 10)]


def work(plan, out, **options):
    """Return the events of a worker that trains the runs of `plan`."""
    events = []
    runs = (run for group in plan["groups"] for run in group["runs"].items())
    configs = {name: RunConfig(**config) for name, config in runs}
    worker.work(out, configs, lambda *event: events.append(event), progress=False, **options)
    return events


class Limit:
    """A limit of time that has passed after so many checks."""

    def __init__(self, checks):
        self.checks = checks

    @property
    def passed(self):
        self.checks -= 1
        return self.checks < 0


def assert_equal_runs(out, separate_folders):
    """Compare metrics and lanes, bit for bit with the release of jax for which XLA computes both programs alike."""
    rounding = {} if jax.__version_info__ < (0, 11) else {"rtol": 1e-4, "atol": 1e-7}
    for name, folder in zip(NAMES, separate_folders, strict=True):
        if not rounding:
            assert (out / name / "metrics.csv").read_bytes() == (folder / "metrics.csv").read_bytes()
        actual, expected = map(RunFolder.open, (out / name, folder))
        assert_equal_trees(actual.table().metrics, expected.table().metrics, **rounding)
        assert_equal_trees(load_lanes(actual)[2], load_lanes(expected)[2], **rounding)


def test_two_runs_in_one_program_equal_separate_runs(tmp_path, grid, separate_folders):
    one, other = ((folder / "metrics.csv").read_text() for folder in separate_folders)
    assert one != other
    out = tmp_path / "out"
    plan = worker.plan(grid, out)
    assert [state for _, state, _ in work(plan, out)] == ["started", "started", "done", "done"]
    assert_equal_runs(out, separate_folders)
    assert work(plan, out) == [(name, "done", "") for name in NAMES]
    finished = {"out": str(out), "imports": [], "finished": NAMES, "groups": []}
    assert worker.plan(grid, out) == finished
    for name in NAMES:
        shutil.rmtree(out / name / "checkpoints")
    assert worker.plan(grid, out) == finished
    (out / NAMES[0] / "policies.npz").unlink()
    assert [list(group["runs"]) for group in worker.plan(grid, out)["groups"]] == [NAMES[:1]]


def test_runs_of_different_checkpoints_continue_in_separate_programs(tmp_path, grid, separate_folders, monkeypatch):
    save, saved_steps = runner.save, []

    def fail_at_fourth_save(folder, train_state, span):
        saved_steps.append(int(train_state.step))
        if len(saved_steps) == 4:
            raise OSError("no space left")
        return save(folder, train_state, span)

    monkeypatch.setattr(runner, "save", fail_at_fourth_save)
    out = tmp_path / "out"
    events = work(worker.plan(grid, out), out)
    assert saved_steps == [40, 40, 80, 80]
    assert events[-1] == (NAMES[1], "failed", "OSError: no space left")
    monkeypatch.setattr(runner, "save", save)
    plan = worker.plan(grid, out)
    assert [(list(group["runs"]), group["step"]) for group in plan["groups"]] == [(NAMES[:1], 80), (NAMES[1:], 40)]
    assert (NAMES[0], "resumed", "from step 80") in work(plan, out)
    assert_equal_runs(out, separate_folders)


def test_runs_of_a_grid_with_more_steps_go_on_from_their_last_checkpoint(tmp_path, grid, separate_folders):
    """Runs that stop at step 80 stand for shorter ones, whose program would take long to compile."""
    out = tmp_path / "out"
    work(worker.plan(grid, out), out, limit=Limit(5))
    with pytest.raises(ValueError, match="began without the log tensorboard; leave out --log, or choose another --out"):
        worker.plan(grid, out, logs=["tensorboard"])
    for name in NAMES:
        RunFolder.open(out / name).record(steps=80)
    plan = worker.plan(grid, out)
    assert [(group["step"], group["steps"]) for group in plan["groups"]] == [(80, 120)]
    assert (NAMES[0], "resumed", "from step 80") in work(plan, out)
    assert_equal_runs(out, separate_folders)
    shutil.rmtree(out / NAMES[1] / "checkpoints")
    grid.write_text(GRID.replace("steps = 120", "steps = 240"))
    with pytest.raises(ValueError, match=rf"{NAMES[1]} is finished \(120 steps\) and has no checkpoint"):
        worker.plan(grid, out)
    (out / NAMES[1] / "policies.npz").unlink()
    whole = (out / NAMES[1] / "metrics.csv").read_text().splitlines(keepends=True)
    (out / NAMES[1] / "metrics.csv").write_text("".join(whole[:5]))
    grid.write_text(GRID)
    with pytest.raises(ValueError, match=rf"{NAMES[1]} has reached step 80 \(120 steps\) and has no checkpoint"):
        worker.plan(grid, out)


def test_runs_whose_minutes_run_out_continue_as_uninterrupted_ones(tmp_path, grid, separate_folders):
    out = tmp_path / "out"
    plan = worker.plan(grid, out)
    stopped = [(name, "stopped", "at step 20") for name in NAMES]
    assert work(plan, out, limit=Limit(1)) == [(name, "started", "") for name in NAMES] + stopped
    assert work(plan, out, limit=Limit(0)) == stopped
    work(plan, out)
    assert_equal_runs(out, separate_folders)


def test_all_runs_of_a_sweep_are_of_one_text(tmp_path, grid, capsys, registries):
    mine = write_mine(tmp_path)
    record = {"file": str(mine), "sha256": hashlib.sha256(MINE.encode()).hexdigest()}
    grid.write_text('import = "mine.py"\n' + GRID.replace("oracle", "patient"))
    plan = worker.plan(grid, tmp_path / "out")
    assert plan["imports"] == [record]
    task = {"out": plan["out"], "imports": plan["imports"], "runs": plan["groups"][0]["runs"]}
    assert {tuple(config["imports"][0].items()) for config in task["runs"].values()} == {tuple(record.items())}
    mine.write_text(f"{MINE}# edited\n")
    assert process.serve(task) == 2
    events = [json.loads(text) for text in capsys.readouterr().out.split(MARK)[1:]]
    assert {event["state"] for event in events} == {"failed"}
    detail = events[0]["detail"]
    assert f"{mine} has changed since this command first read it (sha256 {record['sha256'][:8]} then" in detail
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("message", ["config.json is damaged", "is in use by another process"])
def test_a_run_whose_folder_cannot_be_used_fails_with_its_cause(tmp_path, grid, capsys, message):
    fields = worker.plan(grid, tmp_path)["groups"][0]["runs"][NAMES[0]]
    folder = RunFolder.create(tmp_path / NAMES[0], RunConfig(**fields), "kinematic")
    folder.append(40, {"deployed/success": np.zeros(2)})
    with folder.claimed() if "in use" in message else contextlib.nullcontext():
        if "damaged" in message:
            folder.config_file.write_text("{}")
        assert process.serve({"out": str(tmp_path), "runs": {NAMES[0]: fields}}) == 1
    event = json.loads(capsys.readouterr().out.strip(MARK))
    assert (event["run"], event["state"]) == (NAMES[0], "failed")
    assert message in event["detail"]


def test_a_worker_keeps_to_its_cores_and_ends_with_its_launcher(monkeypatch):
    calls, (reading, writing) = [], os.pipe()
    task = {"out": "", "runs": {}, "progress": False, "cores": [2, 3]}
    os.write(writing, f"{json.dumps(task)}\n".encode())
    monkeypatch.setattr(sys, "argv", ["worker"])
    monkeypatch.setattr(sys, "stdin", os.fdopen(reading))
    monkeypatch.setattr(process, "end_with_pipe", lambda descriptor: calls.append(descriptor == reading))
    monkeypatch.setattr(os, "sched_setaffinity", lambda pid, cores: calls.append((pid, cores)), raising=False)
    monkeypatch.setattr(worker, "work", lambda *_, progress, **options: calls.append(progress))
    assert process.main() == 0
    assert calls == [True, (0, [2, 3]), False]
    os.close(writing)


def test_a_worker_of_an_array_takes_a_line_of_a_file_and_fails_with_its_runs(tmp_path, monkeypatch, capsys):
    runs = [{"runs": {name: {"env": "cheetah", "seeds": []}}} for name in "ab"]
    (tmp_path / "tasks").write_text("".join(f"{json.dumps({'out': str(tmp_path), **task})}\n" for task in runs))
    monkeypatch.setattr(sys, "argv", ["worker", str(tmp_path / "tasks"), "1"])
    monkeypatch.setattr("earl_jax.runs.config.RunConfig", lambda **fields: None)
    assert process.main() == 1
    assert json.loads(capsys.readouterr().out.strip(MARK))["run"] == "b"


def test_a_worker_that_cannot_be_loaded_reports_it_for_each_run(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "earl_jax.runs.config", None)
    assert process.serve({"out": "", "runs": {"a": {}, "b": {}}}) == 2
    events = [json.loads(text) for text in capsys.readouterr().out.split(MARK)[1:]]
    assert [(event["run"], event["state"]) for event in events] == [("a", "failed"), ("b", "failed")]
    assert {event["detail"].partition(": import of ")[0] for event in events} == {"ModuleNotFoundError"}


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
