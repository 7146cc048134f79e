"""Output whose reader has gone, whose disk is full or that was closed costs nothing but the output."""

import contextlib
import io
import os
import pty
import re
import shlex
import signal
import subprocess
import sys

import numpy as np
import pytest

from earl_jax import cli
from earl_jax.runs.progress import Progress
from tests.cli.process import ENVIRONMENT, TASK, run_process, succeed, training

STREAMS = (
    ">&-", "2>&-", "<&-", "<&- >&- 2>&-", ">/dev/full", "2>/dev/full", ">/dev/full 2>&1", "2>&1 | head -1", "| true",
)  # fmt: skip


@pytest.fixture(params=["pipe", "terminal", "full disk"])
def stream(request):
    """A stream, and the function that lets its reader go away."""
    if request.param == "full disk":
        stream, lose = open("/dev/full", "w"), lambda: None  # noqa: SIM115
    else:
        reader, writer = os.pipe() if request.param == "pipe" else pty.openpty()
        stream, lose = os.fdopen(writer, "w"), lambda: os.close(reader)
    yield stream, lose
    with contextlib.suppress(OSError):
        stream.close()


def test_progress_goes_on_without_its_reader(stream, monkeypatch):
    stream, lose = stream
    monkeypatch.setattr("sys.stderr", stream)
    bar = Progress(label="x", steps=400, metric="deployed/success", show=True)
    lose()
    with bar:
        with bar.working("training"):
            bar.message("a line")
        bar.advance(400, 1.0)
        bar.report(400, {"deployed/success": np.array([0.5]), "continuing/reward": np.array([0.25])})
    assert isinstance(bar._stream.failure, OSError)


def test_progress_of_a_process_without_stderr_stays_off_stdout(monkeypatch, capsys):
    monkeypatch.setattr("sys.stderr", None)
    with Progress(label="x", steps=400, metric="deployed/success", show=True) as bar:
        bar.message("a line")
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize("arguments", [["list"], ["--version"], ["list", "--help"]])
def test_a_command_that_only_prints_says_that_it_could_not(arguments, stream, monkeypatch, capsys):
    stream, lose = stream
    lose()
    monkeypatch.setattr("sys.stdout", stream)
    with pytest.raises(SystemExit) as exit_info:
        cli.main(arguments)
    code, err = exit_info.value.code, capsys.readouterr().err
    assert (code, err) == (1, "") or (code == 2 and re.fullmatch(r"earl-jax: stdout can't be written: .*\n", err))


def test_a_command_that_trains_ends_as_its_training_does(stream, copy, monkeypatch, capsys):
    stream, lose = stream
    lose()
    monkeypatch.setattr("sys.stdout", stream)
    cli.main(["resume", "run"])
    assert "earl-jax: stdout can't be written: [Errno" in capsys.readouterr().err


def test_a_name_that_the_terminal_cannot_show_is_escaped(copy, monkeypatch):
    out = io.TextIOWrapper(io.BytesIO(), "ascii")
    copy.rename("\N{GRINNING FACE}")
    monkeypatch.setattr("sys.stdout", out)
    cli.main(["resume", "\N{GRINNING FACE}"])
    assert out.buffer.getvalue().startswith(rb"\U0001f600: deployed/success")


def command(*arguments):
    return shlex.join([sys.executable, "-m", "earl_jax.cli", *map(str, arguments)])


def shell(text):
    """Return the exit code of a line of bash, in which a pipe has that of its first command that failed."""
    line = ["bash", "-c", f"set -o pipefail; {text}"]
    return subprocess.run(line, stdout=subprocess.PIPE, env=ENVIRONMENT, timeout=300).returncode


@pytest.mark.slow
@pytest.mark.parametrize("redirection", STREAMS)
def test_training_ends_whatever_becomes_of_its_streams(redirection, whole, tmp_path):
    assert shell(f"{command(*training(tmp_path / 'run'))} {redirection}") == 0
    assert (tmp_path / "run/metrics.csv").read_bytes() == (whole / "metrics.csv").read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize("redirection", ["2>&1 | head -1", ">/dev/full 2>&1", "<&- >&- 2>&-"])
def test_a_sweep_ends_whatever_becomes_of_its_streams(redirection, tmp_path):
    grid = f'envs = ["{TASK}"]\nalgos = ["naive"]\nseeds = 2\nsteps = 40\neval_every = 40\neval_episodes = 2\n'
    (tmp_path / "grid.toml").write_text(f"{grid}[options]\nhidden_sizes = [[16]]\nbatch_size = 16\nrandom_steps = 20\n")
    assert shell(f"{command('sweep', tmp_path / 'grid.toml', '--out', tmp_path / 'out')} {redirection}") == 0
    [metrics] = tmp_path.glob("out/**/metrics.csv")
    assert len(metrics.read_text().splitlines()) == 3


@pytest.mark.slow
@pytest.mark.parametrize("controlling", [True, False])
def test_a_terminal_that_closes_costs_no_step(controlling, whole, tmp_path):
    """The process that the terminal controls gets SIGHUP: it saves and ends. Any other goes on."""
    master, slave = pty.openpty()
    heard = ["env", "--default-signal=HUP"]  # also where nohup started the tests
    leader = [*heard, "setsid", *(["--ctty"] if controlling else [])]
    arguments = [*leader, sys.executable, "-m", "earl_jax.cli", *training(tmp_path / "run")]
    process = subprocess.Popen(arguments, stdin=slave, stdout=slave, stderr=slave, env=ENVIRONMENT)
    os.close(slave)
    shown = b""
    while b"compiling" not in shown:
        shown += os.read(master, 1000)
    os.close(master)
    assert process.wait(300) == (128 + signal.SIGHUP if controlling else 0)
    succeed("resume", tmp_path / "run", by=run_process)
    assert (tmp_path / "run/metrics.csv").read_bytes() == (whole / "metrics.csv").read_bytes()


@pytest.mark.slow
def test_a_reader_that_leaves_a_listing_early_ends_it_quietly(tmp_path):
    assert shell(f"{command('list')} 2>{tmp_path / 'err'} | true") == 1
    assert (tmp_path / "err").read_text() == ""
