"""Arguments that several commands share, how they are read, and the output of a command as text or JSON."""

import contextlib
import datetime
import json
import os
import re
import sys
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from earl_jax.errors import InputError
from earl_jax.options.values import TimeLimit, parse_number, parse_whole
from earl_jax.runs.files import RunWarning, format_warning

SEED_TOKEN = re.compile(r"[\d_:,]+")
"""Matches a count, a range or a list of seeds, but no name of a task."""
PYTHON_VALUES = {"True": True, "False": False, "None": None}
"""Values that the docs of options write as in Python; JSON writes them in lower case or as null."""
WARNED: list[str] = []
"""The warnings of runs that the command has printed."""
REGISTRY = ConstructorRegistry()
"""The types that the parser of commands reads in another way than tyro does."""

Positional = tyro.conf.Positional
Texts = Annotated[tuple[tuple[str, ...], ...], tyro.conf.UseAppendAction]
"""Several texts, in one argument or in repeated arguments of the same name."""
Logs = Annotated[tuple[tuple[Literal["tensorboard", "wandb"], ...], ...], tyro.conf.UseAppendAction]
Seeds = Annotated[str | None, tyro.conf.arg(metavar="SEEDS")]


@REGISTRY.primitive_rule
def whole_number_or_path(kind: PrimitiveTypeInfo) -> PrimitiveConstructorSpec | None:
    """Return how the parser reads an int, which can be 1e6, 2.5e6 or 2_500_000, or a path."""
    readers = {int: (parse_whole, "INT"), Path: (_expanded, "PATH")}
    if kind.type not in readers:
        return None
    read, metavar = readers[kind.type]
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=metavar,
        instance_from_str=lambda texts: read(texts[0]),
        is_instance=lambda value: isinstance(value, kind.type),
        str_from_instance=lambda value: [str(value)],
    )


def _expanded(text: str) -> Path:
    """Return the path `text`, with the folder of the user for `~`, which a shell leaves in `--out=~/runs`.

    A path such as `./~`, which differs from the user's folder only by `./`, becomes absolute.

    Raises:
        ValueError: the text is empty, as after an unset shell variable; it would mean the current folder.
    """
    if not text:
        raise ValueError("a path is empty")
    path = Path(os.path.expanduser(text))
    return path.absolute() if str(path).startswith("~") else path


def join_seeds(arguments: list[str]) -> list[str]:
    """Return `arguments` with the list after `--seeds` as one argument, so that the list ends before a task."""
    joined: list[str] = []
    for argument in arguments:
        if joined[-2:-1] == ["--seeds"] and all(map(SEED_TOKEN.fullmatch, (argument, joined[-1]))):
            joined[-1] += f",{argument}"
        else:
            joined.append(argument)
    return joined


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[None]:
    """A context in which `path` is written; if that replaces a file, a line on stderr says so afterwards.

    Raises:
        ValueError: `path` is a file of a run, which would be lost, or a folder.
    """
    from earl_jax.runs.contents import FILES, is_run

    if path.name in FILES and is_run(path.parent):
        raise InputError(f"{path} is a file of a run; choose another name")
    if path.is_dir():
        raise InputError(f"{path} is a folder; choose the name of a file")
    before = path.stat() if path.is_file() else None
    yield
    if before is not None:
        when = datetime.datetime.fromtimestamp(before.st_mtime).isoformat(" ", "seconds")
        print(f"earl-jax: replaced {path} of {when}", file=sys.stderr)


def parse_minutes(text: str | None) -> TimeLimit | None:
    """Return the time limit of `--minutes`, from now on; a ValueError if `text` is not a positive finite number."""
    try:
        minutes = None if text is None else float(text)
    except ValueError:
        minutes = text
    return TimeLimit.of(minutes)


def note_warning(message: Warning | str, category: type[Warning], *details: Any) -> str:
    """Return a warning as a command prints it; a `RunWarning` is also noted for the JSON output."""
    if issubclass(category, RunWarning):
        WARNED.append(str(message))
    return format_warning(message, category, *details)


def emit(result: dict[str, Any], as_json: bool, text: str) -> None:
    """Print `result` as one JSON object with `as_json`, else `text`.

    In JSON, numbers that are not finite become null, and `warnings` lists warnings that were printed on stderr.
    """
    if as_json:
        warned = {"warnings": WARNED} if WARNED else {}
        text = json.dumps(json.loads(json.dumps({**result, **warned}), parse_constant=lambda _: None))
    print(text)


@contextlib.contextmanager
def stopping(as_json: bool, values: dict[str, Any]) -> Iterator[None]:
    """A context that prints `values` and the steps as one JSON object, with `as_json`, if a signal stops training."""
    from earl_jax.training.stopping import Stopped

    try:
        yield
    except Stopped as stopped:
        if as_json:
            emit({**values, "steps": stopped.step, "stopped": True}, as_json, "")
        raise


def parse_options(pairs: Iterable[str], others: Collection[str] = ()) -> dict[str, Any]:
    """Return name=value `pairs` as a dictionary. A value is JSON, Python's True, False or None, or else text.

    Raises:
        ValueError: a pair has no `=`, its name occurs twice or among `others`, which have an argument of their own, or
            its value has thousands of digits or brackets.
    """
    options = {}
    for pair in pairs:
        name, equals, text = pair.partition("=")
        if not equals:
            raise InputError(f"--set takes name=value, not {pair!r}")
        if name in options or name in others:
            raise InputError(f"{name} is given twice; leave out one of them")
        try:
            options[name] = PYTHON_VALUES[text] if text in PYTHON_VALUES else json.loads(text, parse_float=parse_number)
        except json.JSONDecodeError:
            options[name] = text
        except (ValueError, RecursionError) as error:
            raise InputError(f"--set: {text[:20]}... ({len(text)} characters) is not a value: {error}") from None
    return options
