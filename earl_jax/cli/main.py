"""Reset-free reinforcement learning: train agents, inspect runs, reproduce the results of the EARL paper."""

import argparse
import contextlib
import gc
import os
import shutil
import sys
import warnings
from collections.abc import Iterator, Sequence

import tyro

from earl_jax import __version__
from earl_jax.cli.arguments import REGISTRY, WARNED, join_seeds, note_warning
from earl_jax.cli.episodes import demos, export, import_demos, render
from earl_jax.cli.help_text import readable
from earl_jax.cli.inspect_runs import best, compare, evaluate, plot, report, show, table
from earl_jax.cli.listing import list_
from earl_jax.cli.quickstart import quickstart
from earl_jax.cli.sweep import reproduce, search, sweep
from earl_jax.cli.train import refuse_options, resume, train
from earl_jax.cli.xla_flags import HELP, set_flags, trains
from earl_jax.errors import is_input_error
from earl_jax.options import imports
from earl_jax.options.environment import FRACTION, start_failure
from earl_jax.runs.streams import LastingStream, lasting_streams

FUNCTIONS = (
    list_, train, resume, sweep, search, reproduce, show, evaluate, plot, table, best, compare, render, report, demos,
    import_demos, export, quickstart,
)  # fmt: skip
COMMANDS = {function.__name__.strip("_").replace("_", "-"): readable(function) for function in FUNCTIONS}
LAUNCHERS = ("sweep", "reproduce")
"""Commands that leave the files of `--import` to their workers, because a launcher does not load jax."""
OPTIONS = argparse.ArgumentParser("earl-jax", add_help=False, allow_abbrev=False)
OPTIONS.add_argument("--import", metavar="FILE", action="append", default=[], dest="files")
OPTIONS.add_argument("--traceback", action="store_true")
NARROWEST = 40
"""Smallest number of columns for which the help is laid out; with five or fewer, the parser would not terminate."""
LONGEST = 1800
"""Largest number of characters in an error line; a path in it can have thousands."""
DESCRIPTION = f"""{__doc__}

Every command takes --import FILE, once for each Python file that registers tasks, methods or learners of your own. \
With --traceback, invalid input prints a traceback instead of one line. --version prints the version."""


def main(arguments: list[str] | None = None) -> None:
    """Run one command.

    On invalid input the command exits with code 2 and a one-line error that gives the cause or the valid choices, or
    with the traceback if `--traceback` is given. Errors in the code of a task or a method always keep their traceback.
    """
    arguments = sys.argv[1:] if arguments is None else arguments
    options, given = OPTIONS.parse_known_args(arguments)
    with lasting_streams() as stdout:
        try:
            with _complete(stdout, trains(given)):
                _run(given, options.files)
        except KeyboardInterrupt as interrupt:
            code = getattr(interrupt, "exit_code", 130)  # a Stopped, or Ctrl-C elsewhere
            print(f"earl-jax: {str(interrupt) or 'interrupted'}", file=sys.stderr)
            raise SystemExit(code) from None
        except BrokenPipeError:  # the reader of the output has gone, as in `earl-jax list | head`
            raise SystemExit(1) from None
        except Exception as error:
            cause = _text(error) if is_input_error(error) else start_failure(error)
            if isinstance(getattr(sys, "last_value", None), KeyboardInterrupt):  # numpy printed it while jax was loaded
                print("earl-jax: interrupted", file=sys.stderr)
                raise SystemExit(130) from None
            if cause is None or options.traceback:
                raise
            if len(cause) > LONGEST:
                cause = f"{cause[: LONGEST // 2]} ... {cause[-LONGEST // 2 :]}"
            print(f"earl-jax: {cause}", file=sys.stderr)
            raise SystemExit(2) from None


def _text(error: Exception) -> str:
    """Return what `error` says; an error of the system without its number."""
    if isinstance(error, OSError) and error.filename is not None and error.strerror:
        return f"{error.filename}: {error.strerror}"
    return str(error)


@contextlib.contextmanager
def _complete(stdout: LastingStream, training: bool) -> Iterator[None]:
    """A context that raises a failure of `stdout` at its end, or prints it after `training`, which is complete then."""
    try:
        yield
    finally:
        stdout.flush()
        if stdout.failure:
            message = f"stdout can't be written: {stdout.failure}"
            if not training:
                raise type(stdout.failure)(message)
            print(f"earl-jax: {message}", file=sys.stderr)


def _run(arguments: list[str], files: Sequence[str]) -> None:
    """Set up the process, import `files` and run the command in `arguments`.

    On a GPU, jax may use 95 % of the memory instead of its default 75 %, because replay buffers need it.
    """
    if arguments == ["--version"]:
        print(f"earl-jax {__version__}")
        return
    if HELP & set(arguments) and shutil.get_terminal_size().columns < NARROWEST:
        os.environ["COLUMNS"] = str(NARROWEST)
    gc.set_threshold(100_000, 50, 50)  # tracing makes many objects: collections take a third of its time by default
    WARNED.clear()
    warnings.formatwarning = note_warning
    os.environ.setdefault(FRACTION, "0.95")
    set_flags(arguments)
    for file in files:
        imports.note(file)
    if not (HELP & set(arguments) or set(LAUNCHERS) & set(arguments[:1])):
        imports.run_noted()
    if arguments[:1] == ["train"]:
        refuse_options(arguments)
    tyro.extras.subcommand_cli_from_dict(
        COMMANDS,
        prog="earl-jax",
        args=join_seeds(arguments),
        description=DESCRIPTION,
        config=(tyro.conf.DisallowNone,),
        registry=REGISTRY,
    )
