"""Signals and time limits end training after a chunk, with a checkpoint from which it continues bit-identically."""

import json
import os
import signal
import time
from unittest.mock import Mock

import jax
import numpy as np
import pytest

from earl_jax import resume
from earl_jax.envs import make
from earl_jax.options.values import TimeLimit
from earl_jax.runs.checkpoint import newest
from earl_jax.runs.folder import RunFolder
from earl_jax.runs.progress import Progress
from earl_jax.training import runner
from earl_jax.training.stopping import Stopped, StopRequest
from tests.cli.process import one_line, run, succeed
from tests.conftest import make_config, tiny_method, tiny_train

HANDLERS = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL, signal.SIGHUP: signal.SIG_DFL}


@pytest.fixture(autouse=True)
def _default_handlers():
    """Give signals the handlers of an ordinary process, which a worker of the tests changes."""
    earlier = {number: signal.signal(number, handler) for number, handler in HANDLERS.items()}
    yield
    for number, handler in earlier.items():
        signal.signal(number, handler)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "whole"
    tiny_train("vaprl", out=folder, checkpoint_every=40)
    return folder


def assert_same_files(folder, whole):
    for name in ("metrics.csv", "policies.npz"):
        assert (folder / name).read_bytes() == (whole / name).read_bytes()


def call_after(monkeypatch, chunks, action):
    """Call `action` once, after `chunks` chunks of 20 steps; an evaluation follows every second one."""
    advance, calls = Progress.advance, []

    def advance_and_call(self, steps, seconds):
        advance(self, steps, seconds)
        calls.append(steps)
        if len(calls) == chunks:
            action()

    monkeypatch.setattr(Progress, "advance", advance_and_call)


def put_clock_forward(monkeypatch):
    """Let an hour pass at once."""
    later = time.monotonic() + 3600
    monkeypatch.setattr(time, "monotonic", lambda: later)


@pytest.mark.parametrize(
    ("number", "chunks", "code"), [(signal.SIGINT, 1, 130), (signal.SIGTERM, 3, 143), (signal.SIGHUP, 4, 129)]
)
def test_a_stopped_run_continues_bit_identically(whole, tmp_path, monkeypatch, number, chunks, code):
    """The signal arrives after the random steps, between two evaluations, and before an evaluation."""
    folder = tmp_path / "run"
    call_after(monkeypatch, chunks, lambda: os.kill(os.getpid(), number))
    with pytest.raises(Stopped, match=f"resume with: earl-jax resume {folder}") as stopped:
        tiny_train("vaprl", out=folder, checkpoint_every=40)
    assert (stopped.value.step, stopped.value.exit_code) == (20 * chunks, code)
    assert (folder / f"checkpoints/{stopped.value.step:09d}").is_dir()
    assert {number: signal.getsignal(number) for number in HANDLERS} == HANDLERS
    resume(folder)
    assert_same_files(folder, whole)


def test_the_run_so_far_is_an_attribute_of_the_exception(monkeypatch):
    """Without a folder, it is all that is left of the run."""
    whole = tiny_train("naive")
    call_after(monkeypatch, 5, lambda: os.kill(os.getpid(), signal.SIGINT))
    with pytest.raises(Stopped) as stopped:
        tiny_train("naive")
    result = stopped.value.result
    assert (result.step, result.steps.tolist(), result.finished) == (100, [40, 80], False)
    for name, values in result.metrics.items():
        np.testing.assert_array_equal(values, whole.metrics[name][:, :2])
    assert result.policy(seed=1)(np.zeros(12)).shape == (3,)


def test_several_runs_that_stop_together_are_not_resumed_one_by_one(tmp_path, monkeypatch):
    configs = [make_config(make("tabletop_organization"), tiny_method("naive"), seeds=(seed,)) for seed in (0, 1)]
    runs = [runner.Run.resolve(config) for config in configs]
    for each in runs:
        each.folder = RunFolder.create(tmp_path / str(each.config.seeds[0]), each.config, "kinematic")
    call_after(monkeypatch, 1, lambda: os.kill(os.getpid(), signal.SIGTERM))
    with pytest.raises(Stopped, match=r"^stopped at step 20 by SIGTERM$"):
        runner.Program(runs, None).run(progress=False, limit=None)
    assert [newest(each.folder.checkpoints) for each in runs] == [20, 20]


@pytest.mark.parametrize("end", [lambda _: os.kill(os.getpid(), signal.SIGTERM), put_clock_forward])
def test_a_signal_or_the_end_of_the_minutes_after_the_last_chunk_changes_nothing(whole, tmp_path, monkeypatch, end):
    call_after(monkeypatch, 6, lambda: end(monkeypatch))
    assert tiny_train("vaprl", out=tmp_path / "run", checkpoint_every=40, minutes=30).finished
    assert_same_files(tmp_path / "run", whole)


def test_the_first_signal_says_what_happens_and_a_second_one_acts_at_once(capsys):
    with StopRequest() as stop:
        os.kill(os.getpid(), signal.SIGINT)
        assert stop.number == signal.SIGINT
        assert capsys.readouterr().err == "SIGINT: stopping after this chunk of steps; a second one stops at once\n"
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)


def test_handlers_of_others_stay_and_an_ignored_signal_is_ignored():
    received = []
    signal.signal(signal.SIGTERM, lambda number, _: received.append(number))
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    with StopRequest() as stop:
        os.kill(os.getpid(), signal.SIGTERM)
        os.kill(os.getpid(), signal.SIGHUP)
    assert (received, stop.number) == ([signal.SIGTERM], None)


def test_a_command_that_is_interrupted_ends_with_one_line_and_the_code_of_the_signal(monkeypatch):
    """tests/cli/test_train.py has a command whose training has stopped."""
    monkeypatch.setattr("earl_jax.training.api.train", Mock(side_effect=KeyboardInterrupt))
    code, _, err = run("train", "tabletop_organization")
    assert (code, err.count("\n")) == (130, 1)


def test_minutes_that_run_out_in_an_evaluation_end_training_there(tmp_path, monkeypatch):
    evaluate = runner._evaluate

    def evaluate_for_an_hour(*arguments):
        put_clock_forward(monkeypatch)
        return evaluate(*arguments)

    monkeypatch.setattr(runner, "_evaluate", evaluate_for_an_hour)
    assert tiny_train("vaprl", out=tmp_path / "run", checkpoint_every=40, minutes=30).step == 40


def test_a_run_without_a_folder_returns_what_it_has():
    result = tiny_train("vaprl", minutes=1e-9)
    assert (result.step, result.metrics) == (20, {})
    with pytest.raises(ValueError, match="no evaluation yet"):
        _ = result.scores


def test_a_signal_to_one_host_or_the_end_of_its_minutes_stops_all(monkeypatch):
    monkeypatch.setattr(jax, "process_count", lambda: 2)
    with StopRequest(TimeLimit.of(30)) as stop:
        os.kill(os.getpid(), signal.SIGTERM)
    assert not stop.requested
    hosts = Mock(side_effect=np.array([[[0, 0], [0, 1]], [[0, 0], [0, 0]], [[0, 0], [signal.SIGTERM, 0]]]))
    monkeypatch.setattr("earl_jax.training.stopping.of_all_hosts", hosts)
    for expected in ((None, True), (None, False), (signal.SIGTERM, True)):
        stop.check()
        assert (stop.number, stop.requested) == expected
    hosts.assert_called_with([signal.SIGTERM, False])


def test_a_signal_during_a_check_is_not_forgotten(monkeypatch):
    def interrupted(numbers):
        os.kill(os.getpid(), signal.SIGINT)
        return np.array([numbers])

    monkeypatch.setattr("earl_jax.training.stopping.of_all_hosts", interrupted)
    with StopRequest() as stop:
        stop.check()
    assert stop.number == signal.SIGINT


def test_commands_whose_start_takes_all_minutes_train_a_chunk_and_print_how_to_continue(whole, tmp_path):
    folder = tmp_path / "a run"
    tiny_train("vaprl", out=folder, checkpoint_every=40, minutes=1e-9)
    assert succeed("evaluate", folder, "--episodes", "2").endswith("\nthe run: no evaluation yet\n")
    expected = {"out": str(folder), "stopped": True, "steps": 40, "resume": f"earl-jax resume '{folder}'"}
    printed = json.loads(succeed("resume", folder, "--minutes", "1e-9", "--json"))
    assert {name: printed[name] for name in expected} == expected
    assert len(printed["score"]["scores"]) == 2
    line = f"stopped at step 60 of 120, the minutes have run out; continue with: earl-jax resume '{folder}'"
    assert succeed("resume", folder, "--minutes", "1e-9").splitlines()[1] == line
    printed = json.loads(succeed("resume", folder, "--json"))
    assert (printed["steps"], printed["stopped"]) == (120, False)
    assert_same_files(folder, whole)


def test_invalid_minutes_are_one_line_before_anything_starts(tmp_path):
    command = ("train", "tabletop_organization", "--out", tmp_path / "out")
    one_line(run(*command, "--minutes", "soon"), "minutes must lie in (0, inf), not 'soon'")
    assert not (tmp_path / "out").exists()
