"""The descriptions of all tasks and methods: a table for those of the package, and the classes of other packages.

The classes import jax, which takes seconds, so `make catalog` writes the table from them, and a test compares the two.
"""

import functools
import json
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

from earl_jax import algos, envs
from earl_jax.errors import InputError
from earl_jax.presets import LENGTHS, PRESETS

TABLE = Path(__file__).with_name("catalog.json")
LOCATE = {"task": envs.locate_env, "method": algos.locate_algo}


def catalog() -> dict[str, Any]:
    """Return the names of the tasks (`envs`) and methods (`algos`), their descriptions, the learner's options and the presets.

    A name whose class cannot be loaded, or that several packages claim, has the key `error` instead of the rest.
    """
    tasks, methods = envs.list_envs(), algos.list_algos()
    return {
        "envs": tasks,
        "algos": methods,
        "tasks": {name: describe("task", name) for name in tasks},
        "methods": {name: describe("method", name) for name in methods},
        "learner": learner_options(),
        "presets": {name: describe_preset(name) for name in PRESETS},
    }


def describe(kind: str, name: str) -> dict[str, Any]:
    """Return the description of a task or a method, as `kind` says: what it is, sizes or source, options, policies."""
    try:
        target, package = LOCATE[kind](name)
    except InputError as error:
        return {"kind": kind, "name": name, "package": "", "error": str(error)}
    path = target.value if isinstance(target, EntryPoint) else f"{target.__module__}:{target.__qualname__}"
    stored = _table()[f"{kind}s"].get(name)
    if stored and stored["class"] == path:
        return stored
    from earl_jax.cli import descriptions

    first = {"kind": kind, "name": name, "package": package, "class": path}
    try:
        return {**first, **descriptions.DESCRIBE[kind](name)}
    except Exception as error:  # the code of another package
        return {**first, "error": str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"}


def describe_preset(name: str) -> dict[str, Any]:
    """Return the description of the preset `name`: what it is, its seeds and lengths, and its options of the learner.

    The steps are None where they are those of the paper for the task.
    """
    values = PRESETS[name]
    lengths = {**LENGTHS, "steps": None, **values.lengths}
    options = {option: list(v) if isinstance(v, tuple) else v for option, v in values.options.items()}
    return {"kind": "preset", "name": name, "summary": values.summary, **lengths, "values": options}


def learner_options() -> dict[str, Any]:
    """Return the options that every method has in addition to its own."""
    return _table()["learner"]


@functools.cache
def _table() -> dict[str, Any]:
    return json.loads(TABLE.read_text())
