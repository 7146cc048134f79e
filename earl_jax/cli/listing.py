"""The command that describes tasks and methods: list."""

import textwrap
from collections.abc import Iterable
from typing import Any

from earl_jax.cli.arguments import JSON, Positional, emit
from earl_jax.errors import InputError
from earl_jax.presets import PRESETS

WIDTH = 80
LARGEST_INT = str(2**31 - 1)
TASK_ROW = "{:<21}{:>4}{:>5}{:>4}  {:<8}{:>8}{:>6}{:>7}  {:<7}{:<6}"
METHOD_ROW = "{:<12}{:<6}{:<16}{}"
TASK_NOTE = """obs, goal, act: sizes. reward: the default, sparse or dense; --set reward_type=... takes \
the other. H_T: steps between hard interventions; H_E: steps of an evaluation episode; change: steps between goal changes \
in the continuing setting. demos: demonstrations that ship. engine: MuJoCo's is auto, {}; "none" is plain arithmetic."""
METHOD_NOTE = """Every method also has the learner's options: {}."""
PUBLISHED = "published"
PRESET_ROW = "{:<12}{:>5}{:>12}{:>10}"
PRESET_NOTE = """A preset is a name for seeds, lengths and options of the learner: train --preset NAME, \
preset = "NAME" in a sweep file, earl_jax.preset(NAME, TASK) in Python. What is given besides wins."""
MORE = "earl-jax list NAME describes a task or a method with all of its options; --json prints everything."


def list_(name: Positional[str | None] = None, json: JSON = False) -> None:
    """List the tasks, methods and presets, with those of installed packages, or describe one of them.

    Args:
        name: Task, method or preset to describe with all of its options. By default all are listed.
    """
    from earl_jax.cli import catalog

    if name is None:
        everything = catalog.catalog()
        emit(everything, json, _overview(everything))
        return
    from earl_jax import algos, envs

    if name in envs.list_envs():
        described = [catalog.describe("task", name)]
    elif name in algos.list_algos():
        described = [{**catalog.describe("method", name), "learner": catalog.learner_options()}]
    elif name in PRESETS:
        described = [catalog.describe_preset(name)]
    else:
        choices = ", ".join([*envs.list_envs(), *algos.list_algos(), *PRESETS])
        raise InputError(f"there is no task, method or preset {name!r}; choose from {choices}")
    emit(described[0], json, _details(described[0]))


def _overview(everything: dict[str, Any]) -> str:
    """Return the tables of all tasks and methods."""
    tasks, methods = everything["tasks"].values(), everything["methods"].values()
    engines = next((task["engines"] for task in tasks if task.get("engines")), [])
    lines = [TASK_ROW.format("task", "obs", "goal", "act", "reward", "H_T", "H_E", "change", "demos", "engine")]
    for task in tasks:
        lines += [_task_row(task), *_below(task)]
    lines += ["", *_wrap(TASK_NOTE.format(_either(engines))), ""]
    lines.append(METHOD_ROW.format("method", "year", "demonstrations", "source"))
    for method in methods:
        lines += [*_method_row(method), *_below(method)]
    lines += ["", *_wrap(METHOD_NOTE.format(", ".join(everything["learner"]))), ""]
    lines.append(PRESET_ROW.format("preset", "seeds", "steps", "episodes"))
    for preset in everything["presets"].values():
        lines += _preset_rows(preset)
    lines += ["", *_wrap(PRESET_NOTE), "", *_wrap(MORE)]
    return "\n".join(line.rstrip() for line in lines)


def _preset_rows(preset: dict[str, Any]) -> list[str]:
    steps = _number(preset["steps"]) if preset["steps"] else PUBLISHED
    options = ", ".join(f"{name}={_cell(value)}" for name, value in preset["values"].items()) or "none"
    row = PRESET_ROW.format(preset["name"], preset["seeds"], steps, preset["eval_episodes"])
    return [row, *_wrap(preset["summary"], "    "), *_wrap(f"Options: {options}.", "    ")]


def _task_row(task: dict[str, Any]) -> str:
    if "error" in task:
        return task["name"]
    keys = ("obs_size", "goal_size", "action_size", "reward_type", "train_horizon", "eval_horizon", "goal_change")
    demos = {0: "none", 1: "".join(task["demonstrations"])}.get(len(task["demonstrations"]), "both")
    values = [task.get(key) for key in keys]
    cells = [value if isinstance(value, str) else _number(value) for value in values]
    return TASK_ROW.format(task["name"], *cells, demos, "MuJoCo" if task["engines"] else "none")


def _method_row(method: dict[str, Any]) -> list[str]:
    if "error" in method:
        return [method["name"]]
    demos = "needed" if method["needs_demonstrations"] else "used if any"
    start = METHOD_ROW.format(method["name"], method["year"] or "-", demos, "")
    return textwrap.wrap(method["source"] or "-", WIDTH, initial_indent=start, subsequent_indent=" " * len(start))


def _below(described: dict[str, Any]) -> Iterable[str]:
    """Return the lines below a row: what it is, its options, and the package if it is another one."""
    if "error" in described:
        return _wrap(described["error"], "    ")
    named = [f"{name}={_cell(option['default'])}" for name, option in described["options"].items() if _is_own(name)]
    package = [f"From {described['package']}."] if described["package"] != "earl_jax" else []
    options = [f"Options: {', '.join(named)}."] if named else []
    policies = [f"Trained policies: {', '.join(described['policies'])}."] if described["policies"] else []
    texts = (" ".join([described["summary"], *package]), *options, *policies)
    return [line for text in texts for line in _wrap(text, "    ")]


def _is_own(option: str) -> bool:
    """Return whether the table does not show the option of a task in a column of its own."""
    return option not in ("reward_type", "train_horizon", "eval_horizon", "demo_file", "engine")


def _details(described: dict[str, Any]) -> str:
    """Return all of the description of one task or method."""
    hidden = ("name", "kind", "options", "learner", "details", "summary", "values", "policies")
    facts = {key.replace("_", " "): str(v) if key == "year" else v for key, v in described.items() if key not in hidden}
    if described["kind"] == "preset":
        facts["steps"] = described["steps"] or PUBLISHED
    lines = [f"{described['name']} ({described['kind']})"]
    if "summary" in described:
        lines += ["", *_wrap(described["summary"])]
    lines.append("")
    for key, value in facts.items():
        lines += textwrap.wrap(_cell(value), WIDTH, initial_indent=f"{key:<22}", subsequent_indent=" " * 22)
    for paragraph in described.get("details", []):
        lines += ["", *_wrap(paragraph)] if paragraph != described["summary"] else []
    lines += [f"{name:<22}{_cell(value)}" for name, value in described.get("values", {}).items()]
    lines += _policies_text(described)
    lines += _options_text("options", described.get("options", {}))
    lines += _options_text("options of the learner, which every method has", described.get("learner", {}))
    return "\n".join(line.rstrip() for line in lines)


def _policies_text(described: dict[str, Any]) -> list[str]:
    """Return a line for each trained policy that ships, with the scores of its seeds."""
    policies = described.get("policies")
    if not policies:
        return []
    title = "TASK, {name!r}" if described["kind"] == "method" else "{name!r}, METHOD"
    lines = ["", f"trained policies that ship (earl_jax.pretrained({title.format(**described)})):"]
    for name, policy in policies.items():
        seeds, *scores = (_cell(policy[key])[1:-1] for key in ("seeds", "deployed/success", "deployed/return"))
        lines += _wrap(f"{name}: of a run of {_number(policy['step'])} steps, in {policy['episodes']} episodes:", "  ")
        lines += _wrap(f"seeds {seeds}; success {scores[0]}; return {scores[1]}", "      ")
    return lines


def _options_text(title: str, options: dict[str, Any]) -> list[str]:
    if not options:
        return []
    lines = ["", f"{title} (--set NAME=VALUE):"]
    for name, option in options.items():
        among = f"; {_valid_text(option['valid'])}" if option["valid"] else ""
        lines += _wrap(f"{name}={_cell(option['default'])}  ({option['type']}{among})", "  ")
        lines += _wrap(option["meaning"], "      ")
    return lines


def _cell(value: Any) -> str:
    """Return `value` as a user writes or reads it."""
    if isinstance(value, bool):
        return str(value).lower()
    if value is None or value == []:
        return "none"
    if isinstance(value, list):
        return f"[{', '.join(map(_cell, value))}]" if not isinstance(value[0], str) else ", ".join(value)
    return str(value)


def _number(value: int | None) -> str:
    return "-" if value is None else f"{value:,}"


def _valid_text(valid: list[Any] | str) -> str:
    """Return the valid values in words; an interval up to the largest int32 has no upper end for a user."""
    if isinstance(valid, list):
        return _either(valid)
    low, _, high = valid[1:-1].partition(", ")
    return f"at least {low}" if high == LARGEST_INT else f"in {valid}"


def _either(values: list[Any]) -> str:
    return " or ".join(filter(None, [", ".join(map(str, values[:-1])), *map(str, values[-1:])]))


def _wrap(text: str, indent: str = "") -> list[str]:
    return textwrap.wrap(text, WIDTH, initial_indent=indent, subsequent_indent=indent, break_on_hyphens=False)
