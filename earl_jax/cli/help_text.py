"""The help of a command: names of values such as FOLDER and NAME=VALUE ..., defaults in words, paragraphs without breaks."""

import inspect
import re
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin

import tyro

NO_DEFAULTS = (None, (), inspect.Parameter.empty)
VALUES = {
    "algo": "METHOD",
    "config": "RUN",
    "engine": "ENGINE",
    "env": "TASK",
    "folder": "RUN",
    "folders": "FOLDER",
    "grid": "FILE",
    "hosts": "HOSTS",
    "metric": "COLUMN",
    "policy": "METHOD",
    "set": "NAME=VALUE",
    "slurm": "NAME=VALUE",
    "space": "FILE",
    "tasks": "TASK",
}
"""What the value of an argument is called, where its type (PATH, INT) or its own name does not say it."""
CONTINUED = re.compile(r"\n {12,}(?=\S)")
"""The break of a line within the description of an argument, which the parser would print."""


def readable(command: Callable[..., Any]) -> Callable[..., Any]:
    """Give `command` a help that names values, and prints no default where it is None or empty: the text says it."""
    for name, parameter in inspect.signature(command).parameters.items():
        hint = "" if parameter.default in NO_DEFAULTS else None
        argument = tyro.conf.arg(metavar=_metavar(parameter), help_behavior_hint=hint)
        command.__annotations__[name] = Annotated[parameter.annotation, argument]
    command.__doc__ = CONTINUED.sub(" ", command.__doc__ or "")
    return command


def _metavar(parameter: inspect.Parameter) -> str | None:
    """Return what the help calls the value of `parameter`; None where the parser's own name for it is right."""
    is_annotated = get_origin(parameter.annotation) is Annotated
    kind, *metadata = get_args(parameter.annotation) if is_annotated else (parameter.annotation,)
    parts = {*get_args(kind), kind}
    if any(getattr(item, "metavar", None) for item in metadata) or not (parts & {str, Path, ...}):
        return None
    literals = [f"{{{','.join(get_args(part))}}}" for part in parts if get_origin(part) is Literal]
    is_positional = get_args(tyro.conf.Positional[int])[1] in metadata
    own = parameter.name.upper() if is_positional else "PATH" if Path in parts else "NAME"
    name = VALUES.get(parameter.name) or next(iter(literals), own)
    several = f"{name} ..." if ... in parts else name
    return f"[{several}]" if is_positional and parameter.default is None else several
