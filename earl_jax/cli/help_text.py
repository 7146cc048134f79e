"""The help of a command: names of values such as FOLDER and NAME=VALUE ..., defaults in words, paragraphs without breaks."""

import functools
import inspect
import re
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin

import tyro

NO_DEFAULTS = (None, (), inspect.Parameter.empty)
VALUES = {
    "algo": "METHOD",
    "camera": "NAME",
    "config": "RUN",
    "engine": "ENGINE",
    "env": "TASK",
    "folder": "RUN",
    "folders": "FOLDER",
    "grid": "FILE",
    "hosts": "HOSTS",
    "labels": "NAME",
    "metric": "COLUMN",
    "policy": "METHOD",
    "preset": "NAME",
    "set": "NAME=VALUE",
    "slurm": "NAME=VALUE",
    "space": "FILE",
    "tasks": "TASK",
}
"""What the value of an argument is called, where its type (PATH, INT) or its own name does not say it."""
CONTINUED = re.compile(r"\n {12,}(?=\S)")
"""The break of a line within the description of an argument, which the parser would print."""


def readable(command: Callable[..., Any]) -> Callable[..., Any]:
    """Return `command` with a help that names values, and prints no default where it is None or empty; the text says it."""
    signature = inspect.signature(command)

    @functools.wraps(command)
    def run(*args: Any, **options: Any) -> Any:
        return command(*args, **options)

    del run.__wrapped__  # the parser would read the command's own annotations there
    parameters = [_with_help(parameter) for parameter in signature.parameters.values()]
    run.__signature__ = signature.replace(parameters=parameters)  # pyright: ignore[reportAttributeAccessIssue]
    run.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    run.__doc__ = CONTINUED.sub(" ", command.__doc__ or "")
    return run


def _with_help(parameter: inspect.Parameter) -> inspect.Parameter:
    """Return `parameter` with the name of its value and without a default that its text says."""
    hints = {}
    if parameter.default in NO_DEFAULTS:
        hints["help_behavior_hint"] = ""
    if metavar := _metavar(parameter):
        hints["metavar"] = metavar
    hint = tyro.conf.arg(**hints)
    return parameter.replace(annotation=Annotated[parameter.annotation, hint])


def _metavar(parameter: inspect.Parameter) -> str | None:
    """Return what the help calls the value of `parameter`; None where the parser's own name for it is right."""
    is_annotated = get_origin(parameter.annotation) is Annotated
    kind, *metadata = get_args(parameter.annotation) if is_annotated else (parameter.annotation,)
    if any(getattr(item, "metavar", None) for item in metadata):
        return None
    parts = {*get_args(kind), kind}
    if not (parts & {str, Path, ...}):
        return None
    is_positional = get_args(tyro.conf.Positional[int])[1] in metadata
    name = VALUES.get(parameter.name) or (parameter.name.upper() if is_positional else _type_name(parts))
    several = f"{name} ..." if ... in parts else name
    return f"[{several}]" if is_positional and parameter.default is None else several


def _type_name(parts: set[Any]) -> str:
    """Return what a value is called by its type: its choices, PATH or NAME."""
    literals = [get_args(part) for part in parts if get_origin(part) is Literal]
    return f"{{{','.join(literals[0])}}}" if literals else "PATH" if Path in parts else "NAME"
