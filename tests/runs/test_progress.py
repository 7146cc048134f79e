"""Tests of the progress display in piped output: compilation is announced, and nothing is silent for long."""

import io
import re
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from earl_jax.runs import progress
from earl_jax.runs.progress import Progress, duration
from tests.cli.process import wait_until

METRICS = {"deployed/success": np.array([0.25, 0.75]), "continuing/reward": np.array([0.0, 0.5])}


@pytest.fixture
def clock(monkeypatch):
    """What replaces the module `time`."""
    clock = SimpleNamespace(now=100.0, monotonic=lambda: clock.now)
    monkeypatch.setattr(progress, "time", clock)
    monkeypatch.setattr(progress, "SILENCE", 3600.0)
    return clock


def make(show=True):
    return Progress(label="x", steps=400, metric="deployed/success", show=show)


def work(bar, clock, name, seconds, steps=40):
    with bar.working(name):
        clock.now += seconds
    bar.advance(steps, seconds)


@pytest.mark.parametrize("colour", [{}, {"FORCE_COLOR": "1"}])  # the latter as Jupyter gives to the shell
def test_the_first_call_of_each_part_is_announced_and_only_that(clock, capsys, monkeypatch, colour):
    for name, value in colour.items():
        monkeypatch.setenv(name, value)
    with make() as bar:
        bar.start_at(80)
        for _ in range(3):
            work(bar, clock, "training", 12.0)
    err = capsys.readouterr().err
    assert err == "training: compiling (about 10 s) ...\ntraining: the first call took 12 s\n"


def test_a_line_before_the_last_one_has_the_time_left_without_the_compilation(clock, capsys):
    with make() as bar:
        bar.start_at(80)
        work(bar, clock, "training", 500.0)
        bar.report(120, METRICS)
        work(bar, clock, "training", 4.0)
        bar.report(160, METRICS)
        clock.now += 56.0  # an evaluation
        bar.report(160, METRICS)
        work(bar, clock, "training", 4.0, steps=240)
        bar.report(400, METRICS)
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("step")]
    assert lines[0] == "step 120/400  deployed/success 0.500  continuing/reward 0.25000  steps/s 0.1"
    assert lines[1].endswith("steps/s 10  time left 24 s")
    assert lines[2].endswith("steps/s 10  time left 6 min")
    assert lines[3].endswith("steps/s 20")


def test_silence_is_broken_during_a_compilation_and_during_training(monkeypatch):
    monkeypatch.setattr(sys, "stderr", printed := io.StringIO())
    monkeypatch.setattr(progress, "SILENCE", 0.02)
    with make() as bar:
        with bar.working("training"):
            line = "\ntraining: still in the first call, which compiles, after"
            assert wait_until(lambda: line in printed.getvalue(), seconds=20)
        bar.advance(40, 1.0)
        with bar.working("training"):
            assert wait_until(lambda: "\nstep 40/400  training  steps/s 40" in printed.getvalue(), seconds=20)


class Terminal(io.StringIO):
    def isatty(self):
        return not self.closed


def test_the_bar_shows_steps_speed_and_time_left_in_80_columns(monkeypatch):
    for name, value in (("COLUMNS", "80"), ("LINES", "25"), ("TERM", "xterm")):
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(sys, "stderr", printed := Terminal())
    with Progress(label="fbrl x 50 on dhand_lightbulb", steps=5_000_000, metric="deployed/success", show=True) as bar:
        bar.advance(1_234_567, 1000.0)
        bar.report(1_234_567, METRICS)
    text = printed.getvalue().replace("\x1b[0m", "")
    assert "fbrl x 50 on dhand_lightbulb\n" in text
    assert re.search(r"━ \S*1,234,567/5,000,000 steps success 0.50  1,235 steps/s \S*-:--:--", text)


def test_without_show_nothing_is_printed(clock, capsys):
    with make(show=False) as bar:
        work(bar, clock, "training", 1.0)
        bar.report(40, METRICS)
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("seconds", "text"), [(0, "0 s"), (89.4, "89 s"), (90, "2 min"), (3599, "1 h 00 min"), (11100, "3 h 05 min")]
)
def test_durations(seconds, text):
    assert duration(seconds) == text


@pytest.mark.parametrize(
    ("name", "values", "problem"),
    [
        ("diverged", [0, 1], "have diverged"),
        ("help/over", [0, 1], "learn nothing more: their budget is spent"),
        ("faults", [20, 21], "have faults in most steps"),
    ],
)
def test_an_evaluation_counts_the_lanes_that_learn_nothing(capsys, name, values, problem):
    with make() as bar:
        bar.report(40, {**METRICS, name: np.array(values)})
        bar.report(80, METRICS)
    assert capsys.readouterr().err.count(f"1 of 2 lanes {problem}") == 1
