"""The help of a command: names of values such as FOLDER and NAME=VALUE ..., defaults in words, paragraphs without breaks."""

import inspect
import re
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin

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
    "log": "{tensorboard,wandb}",
    "metric": "COLUMN",
    "minutes": "MINUTES",
    "per_device": "INT|auto",
    "policy": "METHOD",
    "set": "NAME=VALUE",
    "slurm": "NAME=VALUE",
    "space": "FILE",
    "tasks": "TASK",
    "window": "STEPS",
}
"""The name of an argument's value in the help, where neither its type (PATH, INT) nor the argument's name says it."""
SHARED = {
    "devices": "Number of devices that share the lanes. By default one, or all devices of several hosts.",
    "engine": "Physics engine of a MuJoCo task: auto, mjx, warp or c; by default auto. Other tasks have none.",
    "hosts": "Run as one of several hosts: auto on a cluster that jax detects, else ADDRESS:PORT,HOSTS,NUMBER. By default "
    "one host.",
    "json": "Print one JSON object on stdout.",
    "labels": "A name for each line, in the order of the lines. By default method and options.",
    "last": "Number of evaluations at the end of a run that its score averages. By default those of its last tenth, at least "
    "five. The paper uses 1.",
    "log": "Loggers to use besides metrics.csv. By default none. A resumed run uses the same loggers.",
    "max_lanes": "Largest number of lanes (runs x seeds) in one program. By default unlimited.",
    "metric": "Column of metrics.csv to show, compare or rank by, highest first, such as interventions. By default the deployed "
    "score, to which plot and table add the continuing one.",
    "minutes": "Limit of wall-clock time from the start of the command. Training then ends after the current chunk of steps, "
    "with a checkpoint and exit code 0. By default unlimited.",
    "per_device": "Number of programs that train at a time on each GPU of this machine, through NVIDIA MPS, or without a GPU on "
    "its CPU; auto uses the measured number. By default one program, on one GPU.",
    "set": "Options of the task, the setting or the method as name=value pairs.",
    "window": "Number of steps at the end of a run whose evaluations its score averages, instead of --last.",
}
"""The help texts of arguments that several commands have."""
CONTINUED = re.compile(r"\n {8,}(?=\S)")
"""A line break within the description of an argument, which the parser would print."""


def readable(command: Callable[..., Any]) -> Callable[..., Any]:
    """Give `command` a help with names of values and `SHARED`, without empty defaults, which the text describes."""
    for name, parameter in inspect.signature(command).parameters.items():
        hint = "" if parameter.default in NO_DEFAULTS else None
        argument = tyro.conf.arg(metavar=_metavar(parameter), help=SHARED.get(name), help_behavior_hint=hint)
        command.__annotations__[name] = Annotated[parameter.annotation, argument]
    command.__doc__ = CONTINUED.sub(" ", inspect.cleandoc(command.__doc__ or ""))
    return command


def _metavar(parameter: inspect.Parameter) -> str | None:
    """Return what the help calls the value of `parameter`; None where the parser's own name for it is right."""
    is_annotated = get_origin(parameter.annotation) is Annotated
    kind, *metadata = get_args(parameter.annotation) if is_annotated else (parameter.annotation,)
    parts = {*get_args(kind), kind}
    if any(getattr(item, "metavar", None) for item in metadata):
        return None
    if not parts & {str, Path, ...}:
        return VALUES.get(parameter.name)
    is_positional = get_args(tyro.conf.Positional[int])[1] in metadata
    own = parameter.name.upper() if is_positional else "PATH" if Path in parts else "NAME"
    name = VALUES.get(parameter.name, own)
    several = f"{name} ..." if ... in parts else name
    return f"[{several}]" if is_positional and parameter.default is None else several
