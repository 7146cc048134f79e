"""SIGINT and SIGTERM end training after a chunk, with a checkpoint from which it continues bit-identically."""

import os
import signal

import pytest

from earl_jax import cli, resume
from earl_jax.runs.progress import Progress
from earl_jax.training.stopping import Stopped, StopRequest
from tests.conftest import tiny_train

HANDLERS = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL}
PLACES = {"after_random_steps": 1, "within_an_interval": 3, "before_an_evaluation": 4}
"""Chunks of 20 steps, with evaluations every 40 steps, after which the signal arrives."""


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


def send_after(monkeypatch, chunks, number):
    """Send the signal `number` to this process once, after `chunks` chunks."""
    advance, calls = Progress.advance, []

    def advance_and_send(self, steps, seconds):
        advance(self, steps, seconds)
        calls.append(steps)
        if len(calls) == chunks:
            os.kill(os.getpid(), number)

    monkeypatch.setattr(Progress, "advance", advance_and_send)


@pytest.mark.parametrize("number", HANDLERS)
@pytest.mark.parametrize("place", PLACES)
def test_a_stopped_run_continues_bit_identically(whole, tmp_path, monkeypatch, number, place):
    folder = tmp_path / "run"
    send_after(monkeypatch, PLACES[place], number)
    with pytest.raises(Stopped, match=f"resume with: earl-jax resume {folder}") as stopped:
        tiny_train("vaprl", out=folder, checkpoint_every=40)
    assert stopped.value.step == 20 * PLACES[place]
    assert stopped.value.exit_code == {signal.SIGINT: 130, signal.SIGTERM: 143}[number]
    assert (folder / f"checkpoints/{stopped.value.step:09d}").is_dir()
    assert {number: signal.getsignal(number) for number in HANDLERS} == HANDLERS
    resume(folder)
    assert (folder / "metrics.csv").read_bytes() == (whole / "metrics.csv").read_bytes()
    assert (folder / "policies.npz").read_bytes() == (whole / "policies.npz").read_bytes()


def test_a_signal_after_the_last_chunk_changes_nothing(whole, tmp_path, monkeypatch):
    send_after(monkeypatch, 6, signal.SIGTERM)
    tiny_train("vaprl", out=tmp_path / "run", checkpoint_every=40)
    assert (tmp_path / "run/metrics.csv").read_bytes() == (whole / "metrics.csv").read_bytes()


def test_a_second_signal_acts_at_once():
    with StopRequest() as stop:
        os.kill(os.getpid(), signal.SIGINT)
        assert stop.number == signal.SIGINT
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)


def test_handlers_of_others_stay():
    received = []
    signal.signal(signal.SIGTERM, lambda number, _: received.append(number))
    with StopRequest() as stop:
        os.kill(os.getpid(), signal.SIGTERM)
    assert (received, stop.number) == ([signal.SIGTERM], None)


@pytest.mark.parametrize(("interrupt", "code"), [(Stopped(signal.SIGTERM, 20, []), 143), (KeyboardInterrupt(), 130)])
def test_a_command_that_is_stopped_ends_with_one_line_and_the_code_of_its_signal(monkeypatch, capsys, interrupt, code):
    def stop(*_, **__):
        raise interrupt

    monkeypatch.setattr("earl_jax.training.api.resume", stop)
    with pytest.raises(SystemExit) as exit_info:
        cli.main(["resume", "anywhere"])
    assert exit_info.value.code == code
    assert capsys.readouterr().err.count("\n") == 1
