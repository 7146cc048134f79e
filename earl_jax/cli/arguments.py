"""Arguments that several commands share, and the output of a command as text or JSON."""

import contextlib
import datetime
import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from earl_jax.errors import InputError
from earl_jax.options import TimeLimit

Positional = tyro.conf.Positional
JSON = Annotated[bool, tyro.conf.arg(help="Print one JSON object on stdout.")]
Engine = Annotated[
    str | None,
    tyro.conf.arg(
        help="Physics engine of a MuJoCo task: auto, mjx, warp or c; by default auto. Other tasks have none.",
    ),
]
Set = Annotated[
    tuple[str, ...], tyro.conf.arg(help="Options of the task, the setting or the method as name=value pairs.")
]
Seeds = Annotated[str | None, tyro.conf.arg(metavar="SEEDS")]
Devices = Annotated[
    int | None,
    tyro.conf.arg(help="Number of devices that share the lanes. By default one, or all devices of several hosts."),
]
PerDevice = Annotated[
    int | Literal["auto"] | None,
    tyro.conf.arg(
        metavar="INT|auto",
        help="Number of programs that train on each GPU of this machine at a time, through NVIDIA MPS, or auto for the "
        "measured number; on a machine without a GPU, number of programs at a time. By default one, on one GPU.",
    ),
]
Hosts = Annotated[
    str | None,
    tyro.conf.arg(
        help="Run as one of several hosts: auto on a cluster that jax detects, else ADDRESS:PORT,HOSTS,NUMBER. "
        "By default there is one."
    ),
]
Minutes = Annotated[
    str | None,
    tyro.conf.arg(
        metavar="MINUTES",
        help="Limit of wall-clock time from the start of the command. Training ends after the chunk of steps in which it "
        "runs out, with a checkpoint and exit code 0. By default there is none.",
    ),
]
Logs = Annotated[
    tuple[Literal["tensorboard", "wandb"], ...],
    tyro.conf.arg(help="Loggers to use besides metrics.csv. By default none. A resumed run uses the same ones."),
]
Slurm = Annotated[
    tuple[str, ...],
    tyro.conf.arg(help="Options of sbatch as name=value pairs: time (minutes), partition, ... By default none."),
]


Labels = Annotated[
    tuple[str, ...],
    tyro.conf.arg(
        help="Names of the lines, one for each, in the order in which they are shown. By default method and options."
    ),
]
Metric = Annotated[
    str | None,
    tyro.conf.arg(
        help="Column of metrics.csv to show, such as interventions. By default the deployed and continuing scores."
    ),
]


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[None]:
    """A context that writes `path`; where a file was there before, a line on stderr says so after it was replaced."""
    before = path.stat() if path.is_file() else None
    yield
    if before is not None:
        when = datetime.datetime.fromtimestamp(before.st_mtime).isoformat(" ", "seconds")
        print(f"earl-jax: replaced {path} of {when}", file=sys.stderr)


def parse_minutes(text: str | None) -> TimeLimit | None:
    """Return the time limit of `--minutes`, from now on.

    Raises:
        ValueError: `text` is not a positive finite number.
    """
    try:
        minutes = None if text is None else float(text)
    except ValueError:
        minutes = text
    return TimeLimit.of(minutes)


def emit(result: dict[str, Any], as_json: bool, text: str) -> None:
    """Print `result` as one JSON object with `as_json`, else `text`; JSON has null where a number is nan."""
    print(json.dumps(_without_nan(result)) if as_json else text)


def _without_nan(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_nan(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_without_nan(item) for item in value]
    return None if isinstance(value, float) and math.isnan(value) else value


def print_line(line: str) -> None:
    """Print `line` without buffering."""
    print(line, flush=True)


def parse_options(pairs: tuple[str, ...]) -> dict[str, Any]:
    """Return name=value `pairs` as a dictionary.

    Raises:
        ValueError: a pair has no `=`.
    """
    options = {}
    for pair in pairs:
        name, equals, text = pair.partition("=")
        if not equals:
            raise InputError(f"--set takes name=value, not {pair!r}")
        options[name] = _parse_value(text)
    return options


def _parse_value(text: str) -> Any:
    """Return the JSON value of `text`, or `text` itself if it is not JSON, so that names need no quotes."""
    try:
        return json.loads(text)
    except json.JSONDecodeError:
        return text
    except (ValueError, RecursionError) as error:  # a number of thousands of digits, or thousands of brackets
        raise InputError(f"--set: {text[:20]}... ({len(text)} characters) is no value: {error}") from None
