"""The names of all tasks, methods, learners and presets, and descriptions of their classes.

Importing the classes loads jax, which takes about two seconds. `make catalog` therefore stores the descriptions of the
package's own classes in catalog.json, and a test compares the two.
"""

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

from earl_jax.options.presets import PRESETS
from earl_jax.options.registry import ALGOS, ENVS, LEARNERS
from earl_jax.options.values import literals

CATALOG = Path(__file__).with_name("catalog.json")
REGISTRIES = {"task": ENVS, "method": ALGOS, "learner": LEARNERS}
TASK_NUMBERS = ("observation_size", "goal_size", "action_size", "reward_type", "train_horizon", "eval_horizon")
"""The attributes of a task that its description contains."""
SENTENCE = re.compile(r"(?<=[.;])\s+(?=[A-Z`])")
SOURCE = re.compile(r"Source: (.*?\b\d{4}\b.*?)(?<!\bal)\.(?:\s|$)")
YEAR = re.compile(r"\b(?:19|20)\d{2}\b")


def names() -> dict[str, list[str]]:
    """Return the names of all tasks, methods, learners and presets, by kind."""
    return {**{kind: known.names() for kind, known in REGISTRIES.items()}, "preset": list(PRESETS)}


@functools.cache
def stored() -> dict[str, Any]:
    """Return the stored descriptions by class, and under `shared` the options that all learners have."""
    return json.loads(CATALOG.read_text())


def task(name: str) -> dict[str, Any]:
    """Return the description of a task: summary, sizes, rewards, horizons, demonstrations and options."""
    from earl_jax.envs import MujocoEnv

    env = ENVS.make(name)
    options = _options(type(env))
    summary, details = _summary_and_details(type(env))
    return {
        "summary": summary,
        **{cell: getattr(env, cell) for cell in TASK_NUMBERS},
        "goal_change": env.continuing.goal_change,
        "reward_types": options["reward_type"]["valid"],
        "demonstrations": list(env.demonstrations.directions),
        "engines": options["engine"]["valid"][1:] if isinstance(env, MujocoEnv) else [],
        "details": details,
        "options": options,
    }


def method(name: str) -> dict[str, Any]:
    """Return the description of a method: summary, source, year, demonstrations and own options."""
    cls = ALGOS.get(name)
    return {
        **_sourced(cls),
        "needs_demonstrations": cls.needs_demos,
        "uses_demonstrations": list(dict.fromkeys(demos.direction for phase in cls().phases for demos in phase.demos)),
        "options": {option: values for option, values in _options(cls).items() if option != "learner"},
    }


def _sourced(cls: type) -> dict[str, Any]:
    """Return the summary and details of a class, and the source and year that they name."""
    summary, details = _summary_and_details(cls)
    cited = SOURCE.search(" ".join(details))
    year = YEAR.search(cited[1]) if cited else None
    source = {"source": cited[1] if cited else None, "year": int(year[0]) if year else None}
    return {"summary": summary, **source, "details": details}


def learner(name: str) -> dict[str, Any]:
    """Return the description of a learner: summary, source, year and own options."""
    from earl_jax.algos import Learner

    cls = LEARNERS.get(name)
    shared = {field.name for field in dataclasses.fields(Learner)}
    options = {option: values for option, values in _options(cls).items() if option not in shared}
    return {**_sourced(cls), "options": options}


DESCRIBE = {"task": task, "method": method, "learner": learner}


def catalog() -> dict[str, Any]:
    """Return the descriptions of the package's own classes by class, and under `shared` the options of all learners."""
    from earl_jax.algos import Learner

    described: dict[str, Any] = {"shared": _options(Learner)}
    for kind, registry in REGISTRIES.items():
        for name in registry.names():
            target, package = registry.locate(name)
            if package == "earl_jax" and isinstance(target, EntryPoint):
                described[target.value] = DESCRIBE[kind](name)
    return described


def _options(cls: type) -> dict[str, dict[str, Any]]:
    """Return the options of a class by name: type, default, valid values and meaning.

    If a field has no docstring, its meaning is the sentence in a class docstring that names the option.
    """
    import numpy as np  # without it, `list` starts faster

    docstrings, meanings = _documentation(cls)
    sentences = [sentence for text in docstrings for sentence in SENTENCE.split(" ".join(text.split()))]
    options = {}
    for field in dataclasses.fields(cls):
        about = (sentence for sentence in sentences if re.search(rf"`{field.name}[`=]", sentence))
        kind = field.type if isinstance(field.type, str) else inspect.formatannotation(field.type)
        interval, choices = field.metadata.get("interval"), list(literals(cls).get(field.name, []))
        options[field.name] = {
            "type": "str" if choices else kind,
            "default": None if field.default is dataclasses.MISSING else np.asarray(field.default).tolist(),
            "valid": interval.text if interval else choices or None,
            "meaning": meanings.get(field.name) or next(about, ""),
        }
    return options


def _summary_and_details(cls: type) -> tuple[str, list[str]]:
    """Return the first sentence and the paragraphs of the docstring of a class or of its nearest base that has one."""
    text = next(iter(_documentation(cls)[0]), "")
    paragraphs = [" ".join(paragraph.split()) for paragraph in text.split("\n\n") if paragraph.strip()]
    return SENTENCE.split(" ".join(paragraphs))[0], paragraphs


def _documentation(cls: type) -> tuple[list[str], dict[str, str]]:
    """Return the docstrings of a class and of its bases of the same packages, nearest first, and those of their fields.

    They are read from the source: fields have no `__doc__`, and that of a dataclass can be its signature.
    """
    tops = {"earl_jax", cls.__module__.partition(".")[0]}
    docstrings, meanings = [], {}
    for base in (base for base in cls.__mro__ if base.__module__.partition(".")[0] in tops):
        node = ast.parse(textwrap.dedent(inspect.getsource(base))).body[0]
        assert isinstance(node, ast.ClassDef)
        docstrings += filter(None, [ast.get_docstring(node)])
        for field, below in pairwise(node.body):
            match field, below:
                case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                    meanings.setdefault(name, " ".join(text.split()))
    return docstrings, meanings


def store() -> None:
    """Write catalog.json, with a line for each class."""
    lines = [f"{json.dumps(key)}: {json.dumps(value)}" for key, value in catalog().items()]
    CATALOG.write_text("{" + ",\n".join(lines) + "}\n")
