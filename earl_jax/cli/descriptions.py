"""The descriptions of tasks and methods, taken from their classes; as a program, it writes the table of `catalog`."""

import ast
import dataclasses
import functools
import inspect
import json
import re
import textwrap
from importlib.metadata import EntryPoint
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from earl_jax import algos, assets, envs
from earl_jax.cli import catalog
from earl_jax.errors import InputError
from earl_jax.physics.engine_choice import ENGINES

SENTENCE = re.compile(r"(?<=[.;])\s+(?=[A-Z`])")
SOURCE = re.compile(r"Source: (.*?\b\d{4}\b.*?)(?<!\bal)\.(?:\s|$)")
YEAR = re.compile(r"\b(?:19|20)\d{2}\b")
CHOICES = re.compile(r"(?:is not one of|choose from) (.*)$")
DESCRIBED = ("seeds", "step", "episodes", "deployed/success", "deployed/return")


def task(name: str) -> dict[str, Any]:
    """Return what a task is, its sizes, rewards, horizons, demonstrations, policies and options."""
    env = envs.make(name)
    options = {key: {**option, "valid": option["valid"] or _choices(env, key)} for key, option in _options(type(env))}
    return {
        "summary": env.summary or _sentences(_docstrings(type(env))[0])[0],
        "obs_size": env.obs_size,
        "goal_size": env.goal_size,
        "action_size": env.action_size,
        "reward_type": env.reward_type,
        "reward_types": options["reward_type"]["valid"],
        "train_horizon": env.train_horizon,
        "eval_horizon": env.eval_horizon,
        "goal_change": getattr(env, "goal_change", None),
        "demonstrations": list(env.demo_directions),
        "policies": {method: _policy(name, method) for method in assets.list_pretrained().get(name, [])},
        "engines": list(ENGINES) if isinstance(env, envs.MujocoEnv) else [],
        "details": _paragraphs(_docstrings(type(env))[0]),
        "options": options,
    }


def method(name: str) -> dict[str, Any]:
    """Return what a method does, its source, year, demonstrations, policies and own options."""
    cls = algos.algo_class(name)
    docstring = _docstrings(cls)[0]
    cited = SOURCE.search(" ".join(docstring.split()))
    years = YEAR.findall(cited[1]) if cited else []
    return {
        "summary": _sentences(docstring)[0],
        "source": cited[1] if cited else None,
        "year": int(years[0]) if years else None,
        "needs_demonstrations": cls.needs_demos,
        "uses_demonstrations": list(cls.demo_directions),
        "policies": {env: _policy(env, name) for env, methods in assets.list_pretrained().items() if name in methods},
        "details": _paragraphs(docstring),
        "options": {option: values for option, values in _options(cls) if option != "sac"},
    }


DESCRIBE = {"task": task, "method": method}


def table() -> dict[str, Any]:
    """Return the descriptions of all tasks and methods of the package, and the options of the learner."""
    return {
        "tasks": _own("task", envs.list_envs()),
        "methods": _own("method", algos.list_algos()),
        "learner": dict(_options(algos.SAC)),
    }


def _own(kind: str, names: list[str]) -> dict[str, Any]:
    descriptions = {}
    for name in names:
        target, package = catalog.LOCATE[kind](name)
        if package == "earl_jax" and isinstance(target, EntryPoint):
            first = {"kind": kind, "name": name, "package": package, "class": target.value}
            descriptions[name] = {**first, **DESCRIBE[kind](name)}
    return descriptions


def write(path: Path) -> None:
    """Write the table to `path`, each name on a line of its own."""
    lines = [
        f"{json.dumps(group)}: {{\n"
        + ",\n".join(f"{json.dumps(key)}: {json.dumps(value)}" for key, value in entries.items())
        for group, entries in table().items()
    ]
    path.write_text("{" + "},\n".join(lines) + "}}\n")


def _policy(env: str, algo: str) -> dict[str, Any]:
    """Return what is known of the trained policies of a method that ship: seeds, steps, scores, options of the run."""
    from earl_jax.training import pretrained_info

    info = pretrained_info(env, algo)
    options = {**info["config"]["env_options"], **info["config"]["options"]}
    return {**{key: info[key] for key in DESCRIBED}, "options": options}


def _options(cls: type) -> list[tuple[str, dict[str, Any]]]:
    """Return the options of a class by name: type, default, valid values and meaning.

    Where the field has no docstring, the meaning is the sentence of a class's that names the option.
    """
    meanings = _meanings(cls)
    sentences = [sentence for text in _docstrings(cls) for sentence in _sentences(text)]
    options = []
    for field in dataclasses.fields(cls):
        if field.init:
            about = (sentence for sentence in sentences if re.search(rf"`{field.name}[`=]", sentence))
            default = None if field.default is dataclasses.MISSING else np.asarray(field.default).tolist()
            interval = field.metadata.get("interval")
            values = {
                "type": field.type if isinstance(field.type, str) else inspect.formatannotation(field.type),
                "default": default,
                "valid": interval.text if interval else None,
                "meaning": meanings.get(field.name) or next(about, ""),
            }
            options.append((field.name, values))
    return options


def _choices(env: Any, option: str) -> list[str] | None:
    """Return the valid values of an option of text, which the error of another value names; None for other options."""
    if not isinstance(getattr(env, option), str):
        return None
    try:
        dataclasses.replace(env, **{option: "?"})
    except InputError as error:
        named = CHOICES.search(str(error))
        return named[1].split(", ") if named else None


def _meanings(cls: type) -> dict[str, str]:
    """Return the docstrings below the fields of a class and of its bases."""
    meanings = {}
    for node in reversed(_nodes(cls)):
        for field, below in pairwise(node.body):
            match field, below:
                case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                    meanings[name] = " ".join(text.split())
    return meanings


def _docstrings(cls: type) -> list[str]:
    """Return the docstrings of a class and of its bases, nearest first; one that is empty if there is none."""
    return [text for node in _nodes(cls) if (text := ast.get_docstring(node))] or [""]


@functools.cache
def _nodes(cls: type) -> list[ast.ClassDef]:
    """Return the parsed source of a class and of its bases of the same packages, because `__doc__` has no fields'."""
    tops = {"earl_jax", cls.__module__.partition(".")[0]}
    classes = [base for base in cls.__mro__ if base.__module__.partition(".")[0] in tops]
    nodes = [ast.parse(textwrap.dedent(inspect.getsource(base))).body[0] for base in classes]
    return [node for node in nodes if isinstance(node, ast.ClassDef)]


def _sentences(text: str) -> list[str]:
    """Return the sentences of a docstring, each on one line; "" for an empty one."""
    return SENTENCE.split(" ".join(text.split()))


def _paragraphs(text: str) -> list[str]:
    return [" ".join(paragraph.split()) for paragraph in text.split("\n\n") if paragraph.strip()]


if __name__ == "__main__":
    write(catalog.TABLE)
