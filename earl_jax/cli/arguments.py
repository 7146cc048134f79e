"""What the commands of the command line have in common: their arguments, and how they answer."""

import json
from typing import Annotated, Any, Literal

import tyro

Positional = tyro.conf.Positional
JSON = Annotated[bool, tyro.conf.arg(help="Print one JSON object on stdout.")]
Physics = Annotated[
    str | None, tyro.conf.arg(help="Physics engine: auto, mjx, warp or c; only for tasks that have one.")
]
Set = Annotated[
    tuple[str, ...], tyro.conf.arg(help="name=value pairs: options of the task, the setting or the method.")
]
Devices = Annotated[
    int | None, tyro.conf.arg(help="Devices that share the lanes: one, or those of all hosts where there are several.")
]
Hosts = Annotated[
    str | None,
    tyro.conf.arg(
        help="Run as one of several hosts: auto on a cluster that jax knows, else ADDRESS:PORT,HOSTS,NUMBER."
    ),
]
Logs = Annotated[
    tuple[Literal["tensorboard", "wandb"], ...],
    tyro.conf.arg(help="Where metrics go besides metrics.csv; a resumed run goes on with it."),
]
Slurm = Annotated[tuple[str, ...], tyro.conf.arg(help="name=value pairs for sbatch: time (minutes), partition, ...")]


def say(result: dict[str, Any], as_json: bool, text: str) -> None:
    """Print `result` as one JSON object where that is asked for, else `text`."""
    print(json.dumps(result) if as_json else text)


def _value(text: str) -> Any:
    """Return a JSON value where `text` is one, else the text itself, so that names need no quotes."""
    try:
        return json.loads(text)
    except json.JSONDecodeError:
        return text


def options_of(pairs: tuple[str, ...]) -> dict[str, Any]:
    """Return name=value `pairs` as a dictionary."""
    options = {}
    for pair in pairs:
        name, equals, text = pair.partition("=")
        if not equals:
            raise ValueError(f"--set takes name=value, not {pair!r}")
        options[name] = _value(text)
    return options


def say_line(line: str) -> None:
    """Print `line` at once."""
    print(line, flush=True)
