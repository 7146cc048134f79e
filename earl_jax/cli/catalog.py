"""The descriptions of all tasks and methods, taken from the source of their classes: sizes, horizons, options."""

import re
from importlib.metadata import EntryPoint
from typing import Any

from earl_jax import algos, envs
from earl_jax.cli.class_source import ClassSource, Field, class_at
from earl_jax.cli.module_source import module_of
from earl_jax.cli.shipped import demonstrations, policies_of_method, policies_of_task
from earl_jax.errors import InputError
from earl_jax.presets import LENGTHS, PRESETS

SENTENCE = re.compile(r"(?<=[.;])\s+(?=[A-Z`])")
SOURCE = re.compile(r"Source: (.*?\b\d{4}\b.*?)(?<!\bal)\.(?:\s|$)")
YEAR = re.compile(r"\b(?:19|20)\d{2}\b")
SHARED = "sac"
"""The field of a method that holds the learner's options."""


def catalog() -> dict[str, Any]:
    """Return the names of the tasks (`envs`) and methods (`algos`), their descriptions, the learner's options and the presets.

    A name whose class has no source to read, or that several packages claim, has the key `error` instead of the rest.
    """
    tasks, methods = envs.list_envs(), algos.list_algos()
    return {
        "envs": tasks,
        "algos": methods,
        "tasks": {name: describe_task(name) for name in tasks},
        "methods": {name: describe_method(name) for name in methods},
        "learner": learner_options(),
        "presets": {name: describe_preset(name) for name in PRESETS},
    }


def describe_preset(name: str) -> dict[str, Any]:
    """Return the description of the preset `name`: what it is, its seeds and lengths, and its options of the learner.

    The steps are None where they are those of the paper for the task.
    """
    values = PRESETS[name]
    lengths = {**LENGTHS, "steps": None, **values.lengths}
    options = {option: list(v) if isinstance(v, tuple) else v for option, v in values.options.items()}
    return {"kind": "preset", "name": name, "summary": values.summary, **lengths, "values": options}


def describe_task(name: str) -> dict[str, Any]:
    """Return the description of the task `name`: what it is, sizes, rewards, horizons, demonstrations, policies."""
    source, values = _locate("task", name, *_located(envs.locate_env, name))
    if source is None:
        return values
    choices = source.choices()
    options = {option: _option(source, option, field, choices) for option, field in source.fields().items()}
    layout = {**_sizes(source), "action_size": source.constant("action_size")}
    horizons = {key: options[key]["default"] for key in ("train_horizon", "eval_horizon") if key in options}
    return {
        **values,
        "summary": source.constant("summary") or _sentences(source.docstring)[0],
        **layout,
        "reward_type": options.get("reward_type", {}).get("default"),
        "reward_types": choices.get("reward_type", []),
        **horizons,
        "goal_change": source.constant("goal_change"),
        "demonstrations": demonstrations(name),
        "policies": policies_of_task(name),
        "engines": _engines() if source.is_a("MujocoEnv") else [],
        "details": _paragraphs(source.docstring),
        "options": options,
    }


def describe_method(name: str) -> dict[str, Any]:
    """Return the description of the method `name`: what it does, source, year, demonstrations, its own options."""
    source, values = _locate("method", name, *_located(algos.locate_algo, name))
    if source is None:
        return values
    text = " ".join(source.docstring.split())
    cited = SOURCE.search(text)
    years = YEAR.findall(cited[1]) if cited else []
    return {
        **values,
        "summary": _sentences(source.docstring)[0],
        "source": cited[1] if cited else None,
        "year": int(years[0]) if years else None,
        "needs_demonstrations": source.constant("needs_demos", False),
        "uses_demonstrations": source.constant("demo_directions", []),
        "policies": policies_of_method(name),
        "details": _paragraphs(source.docstring),
        "options": {
            option: _option(source, option, field, {}) for option, field in source.fields().items() if option != SHARED
        },
    }


def learner_options() -> dict[str, Any]:
    """Return the options that every method has in addition to its own."""
    source = class_at("earl_jax.algos:SAC")
    assert source, "the learner's source is part of the package"
    return {option: _option(source, option, field, {}) for option, field in source.fields().items()}


def largest_int() -> int:
    """Return `LARGEST_INT` of `earl_jax.options` from its source, because that module imports NumPy."""
    module = module_of("earl_jax.options")
    assert module, "the source of the options is part of the package"
    return module.constant("LARGEST_INT")


def _located(locate: Any, name: str) -> tuple[EntryPoint | type | None, str, str]:
    """Return the target of `name`, its package, and the error that it has instead if several packages claim it."""
    try:
        return (*locate(name), "")
    except InputError as error:
        return None, "", str(error)


def _locate(
    kind: str, name: str, target: EntryPoint | type | None, package: str, error: str
) -> tuple[ClassSource | None, dict[str, Any]]:
    """Return the source of `target`, and the first keys of its description."""
    values: dict[str, Any] = {"kind": kind, "name": name, "package": package}
    if target is None:
        return None, {**values, "error": error}
    path = target.value if isinstance(target, EntryPoint) else f"{target.__module__}:{target.__qualname__}"
    source = class_at(path)
    return source, {**values, "class": path, **({} if source else {"error": f"no source found for {path}"})}


def _option(source: ClassSource, name: str, field: Field, choices: dict[str, list[Any]]) -> dict[str, Any]:
    """Return type, default, valid values and meaning of the option `name`.

    Where the field has no docstring, the meaning is the sentence of the class's that names the option.
    """
    meaning = field.meaning or _sentence_about(name, source)
    valid = choices.get(name) or (["auto", *_engines()] if name == "engine" and source.is_a("MujocoEnv") else None)
    return {"type": field.type, "default": field.value, "valid": valid or field.interval, "meaning": meaning}


def _sentence_about(option: str, source: ClassSource) -> str:
    sentences = [sentence for text in source.docstrings for sentence in _sentences(text)]
    return next((sentence for sentence in sentences if re.search(rf"`{option}[`=]", sentence)), "")


def _sizes(source: ClassSource) -> dict[str, int | None]:
    """Return the sizes of observation and goal: those of the class's properties, else those that its docstring gives."""
    state, goal = source.constant("state_size"), source.constant("goal_size")
    text = " ".join(source.docstrings)
    observed, aimed = re.search(r"`obs \[(\d+)\]`", text), re.search(r"\bgoal (\d+)\b", text)
    if goal is None and aimed:
        goal = int(aimed[1])
    if state is not None and goal is not None:
        return {"obs_size": state + goal, "goal_size": goal}
    return {"obs_size": int(observed[1]) if observed else None, "goal_size": goal}


def _engines() -> list[str]:
    module = module_of("earl_jax.physics.engine_choice")
    return module.constant("ENGINES") if module else []


def _sentences(text: str) -> list[str]:
    """Return the sentences of a docstring, each on one line; "" for an empty one."""
    return SENTENCE.split(" ".join(text.split()))


def _paragraphs(text: str) -> list[str]:
    return [" ".join(paragraph.split()) for paragraph in text.split("\n\n") if paragraph.strip()]
