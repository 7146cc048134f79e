"""The command that describes tasks, methods, learners and presets: list. It imports only the classes of other packages."""

import dataclasses
import textwrap
from importlib.metadata import EntryPoint
from itertools import chain
from typing import Any

from earl_jax import assets
from earl_jax.algos.learner import DEFAULT
from earl_jax.cli.arguments import JSON, Positional, emit
from earl_jax.cli.catalog import LOCATE, TASK_CELLS, names, stored
from earl_jax.errors import InputError
from earl_jax.options.presets import PRESETS
from earl_jax.options.registry import choices

WIDTH = 80
TASK_ROW = "{:<21}{:>4}{:>5}{:>4}  {:<8}{:>8}{:>6}{:>7}  {:<7}{:<6}"
TASK_HEADER = TASK_ROW.format("task", "obs", "goal", "act", "reward", "H_T", "H_E", "change", "demos", "engine")
TASK_NOTE = """obs, goal, act: sizes. reward: the default, sparse or dense; --set reward_type=... takes the other. \
H_T: steps between hard interventions; H_E: steps of an evaluation episode; change: steps between goal changes in the \
continuing setting. demos: demonstrations that ship. engine: MuJoCo's is auto, mjx, warp or c; "none" is plain arithmetic."""
METHOD_ROW = "{:<12}{:<6}{:<16}"
LEARNER_ROW = "{:<12}{:<6}"
LEARNER_NOTE = "A method learns with sac, or with another learner: train --learner NAME. Both have options (--set)."
PRESET_ROW = "{:<12}{:>5}{:>12}{:>10}"
PRESET_NOTE = """A preset is a name for seeds, a schedule and options of the learner: train --preset NAME, \
preset = "NAME" in a sweep file, earl_jax.preset(NAME, TASK) in Python. What is given besides wins."""
MORE = "earl-jax list NAME describes a task, a method or a learner with all of its options; --json prints everything."
SCORES = ("seeds", "step", "episodes", "deployed/success", "deployed/return")
IN_COLUMNS = ("reward_type", "train_horizon", "eval_horizon", "demo_file", "engine")
"""Options of a task that its row shows, or that every task has."""
NOT_FACTS = ("name", "kind", "options", "learner", "shared", "details", "summary", "values", "policies")


def list_(name: Positional[str | None] = None, json: JSON = False) -> None:
    """List the tasks, methods, learners and presets, with those of installed packages, or describe one of them.

    Args:
        name: Task, method, learner or preset to describe with all of its options. By default all are listed.
    """
    if name is None:
        everything = describe_all()
        emit(everything, json, _overview(everything))
        return
    kind = next((kind for kind, known in names().items() if name in known), None)
    if kind is None:
        known = chain(*names().values())
        raise InputError(f"there is no task, method, learner or preset {name!r}; {choices(name, known)}")
    described = describe(kind, name)
    if kind == "method":
        described = {**described, "learner": {**stored()["shared"], **describe("learner", DEFAULT)["options"]}}
    if kind == "learner":
        described = {**described, "shared": stored()["shared"]}
    emit(described, json, _details(described))


def describe_all() -> dict[str, Any]:
    """Return the names of tasks (`envs`) and methods (`algos`), all descriptions, and the options of every learner."""
    known = names()
    described = {f"{kind}s": {name: describe(kind, name) for name in known[kind]} for kind in known}
    return {"envs": known["task"], "algos": known["method"], **described, "shared": stored()["shared"]}


def describe(kind: str, name: str) -> dict[str, Any]:
    """Return what a task, method, learner or preset is: sizes or source, policies and options; of a preset its schedule.

    One whose class cannot be loaded, or that several packages claim, has the key `error` instead.
    """
    if kind == "preset":
        return _preset(name)
    head: dict[str, Any] = {"kind": kind, "name": name, "package": ""}
    try:
        target, head["package"] = LOCATE[kind](name)
        path = target.value if isinstance(target, EntryPoint) else f"{target.__module__}:{target.__qualname__}"
        head |= {"class": path, "policies": _policies(name)}
        return head | (stored().get(path) or _imported(kind, name))
    except Exception as error:  # the code of another package
        return head | {"error": str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"}


def _imported(kind: str, name: str) -> dict[str, Any]:
    from earl_jax.cli import descriptions

    return descriptions.DESCRIBE[kind](name)


def _policies(name: str) -> dict[str, Any]:
    """Return the trained policies that ship, by method for a task and by task for a method: seeds, scores, options."""
    policies = {}
    for task, methods in assets.list_pretrained().items():
        for method in methods:
            if name in (task, method):
                info = assets.pretrained_info(task, method)
                options = {**info["config"]["env_options"], **info["config"]["options"]}
                policies[method if name == task else task] = {**{key: info[key] for key in SCORES}, "options": options}
    return policies


def _preset(name: str) -> dict[str, Any]:
    """Return the description of a preset, whose steps are None where they are those of the paper for the task."""
    preset = PRESETS[name]
    schedule = dataclasses.asdict(preset.schedule) | ({"steps": None} if preset.published_steps else {})
    return {
        "kind": "preset", "name": name, "summary": preset.summary, "seeds": preset.seeds, **schedule,
        "values": preset.options,
    }  # fmt: skip


def _overview(everything: dict[str, Any]) -> str:
    """Return the tables of all tasks, methods and presets, each row with lines below it."""
    kinds = ("tasks", "methods", "learners", "presets")
    tasks, methods, learners, presets = (everything[kind].values() for kind in kinds)
    lines = [TASK_HEADER, *chain(*map(_rows, tasks)), "", *_wrap(TASK_NOTE), ""]
    lines += [METHOD_ROW.format("method", "year", "demonstrations") + "source", *chain(*map(_rows, methods)), ""]
    lines += [LEARNER_ROW.format("learner", "year") + "source", *chain(*map(_rows, learners)), ""]
    lines += [*_wrap(f"Every learner also has these options: {', '.join(everything['shared'])}."), ""]
    lines += [*_wrap(LEARNER_NOTE), ""]
    lines += [PRESET_ROW.format("preset", "seeds", "steps", "episodes"), *chain(*map(_rows, presets)), ""]
    return "\n".join(line.rstrip() for line in [*lines, *_wrap(PRESET_NOTE), "", *_wrap(MORE)])


def _rows(described: dict[str, Any]) -> list[str]:
    """Return the row of a name, and the lines below it: what it is, its package, options and trained policies."""
    if "error" in described:
        return [described["name"], *_wrap(described["error"], "    ")]
    values = described.get("values") or {key: option["default"] for key, option in described.get("options", {}).items()}
    options = ", ".join(f"{key}={_cell(value)}" for key, value in values.items() if key not in IN_COLUMNS)
    package = described.get("package", "earl_jax")
    below = [
        described["summary"] + (f" From {package}." if package != "earl_jax" else ""),
        f"Options: {options}." if options else "",
        f"Trained policies: {', '.join(described['policies'])}." if described.get("policies") else "",
    ]
    return [*ROWS[described["kind"]](described), *chain(*(_wrap(text, "    ") for text in below))]


def _task_row(task: dict[str, Any]) -> list[str]:
    demos = {0: "none", 1: "".join(task["demonstrations"])}.get(len(task["demonstrations"]), "both")
    cells = [_number(task[key]) for key in TASK_CELLS]
    return [TASK_ROW.format(task["name"], *cells, demos, "MuJoCo" if task["engines"] else "none")]


def _method_row(method: dict[str, Any]) -> list[str]:
    demos = "needed" if method["needs_demonstrations"] else "used if any"
    start = METHOD_ROW.format(method["name"], method["year"] or "-", demos)
    return textwrap.wrap(method["source"] or "-", WIDTH, initial_indent=start, subsequent_indent=" " * len(start))


def _learner_row(learner: dict[str, Any]) -> list[str]:
    start = LEARNER_ROW.format(learner["name"], learner["year"] or "-")
    return textwrap.wrap(learner["source"] or "-", WIDTH, initial_indent=start, subsequent_indent=" " * len(start))


def _preset_row(preset: dict[str, Any]) -> list[str]:
    steps = _number(preset["steps"] or "published")
    return [PRESET_ROW.format(preset["name"], preset["seeds"], steps, preset["eval_episodes"])]


ROWS = {"task": _task_row, "method": _method_row, "learner": _learner_row, "preset": _preset_row}


def _details(described: dict[str, Any]) -> str:
    """Return all of the description of one name."""
    facts = {key.replace("_", " "): value for key, value in described.items() if key not in NOT_FACTS}
    facts |= {"steps": described["steps"] or "published"} if described["kind"] == "preset" else {}
    lines = [f"{described['name']} ({described['kind']})", "", *_wrap(described.get("summary", "")), ""]
    for key, value in {**facts, **described.get("values", {})}.items():
        lines += textwrap.wrap(_cell(value), WIDTH, initial_indent=f"{key:<22}", subsequent_indent=" " * 22)
    for paragraph in described.get("details", []):
        lines += ["", *_wrap(paragraph)] if paragraph != described["summary"] else []
    lines += _policies_text(described)
    lines += _options_text("options", described.get("options"))
    lines += _options_text(f"options of the learner {DEFAULT}; --learner takes another", described.get("learner"))
    lines += _options_text("options that every learner has", described.get("shared"))
    return "\n".join(line.rstrip() for line in lines)


def _policies_text(described: dict[str, Any]) -> list[str]:
    """Return lines for each trained policy that ships, with the scores of its seeds."""
    if not described.get("policies"):
        return []
    arguments = f"TASK, {described['name']!r}" if described["kind"] == "method" else f"{described['name']!r}, METHOD"
    lines = ["", f"trained policies that ship (earl_jax.pretrained({arguments})):"]
    for name, policy in described["policies"].items():
        seeds, success, reward = (_cell(policy[key])[1:-1] for key in ("seeds", "deployed/success", "deployed/return"))
        lines += _wrap(f"{name}: of a run of {policy['step']:,} steps, in {policy['episodes']} episodes:", "  ")
        lines += _wrap(f"seeds {seeds}; success {success}; return {reward}", "      ")
    return lines


def _options_text(title: str, options: dict[str, Any] | None) -> list[str]:
    lines = ["", f"{title} (--set NAME=VALUE):"] if options else []
    for name, option in (options or {}).items():
        among = f"; {_valid_text(option['valid'])}" if option["valid"] else ""
        lines += _wrap(f"{name}={_cell(option['default'])}  ({option['type']}{among})", "  ")
        lines += _wrap(option["meaning"], "      ")
    return lines


def _cell(value: Any) -> str:
    """Return `value` as a user writes or reads it."""
    if value is None or value == []:
        return "none"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list | tuple):
        return ", ".join(value) if isinstance(value[0], str) else f"[{', '.join(map(_cell, value))}]"
    return str(value)


def _number(value: int | str | None) -> str:
    """Return a number with separators, a text as it is, and "-" for None."""
    return "-" if value is None else f"{value:,}" if isinstance(value, int) else value


def _valid_text(valid: list[str] | str) -> str:
    """Return the valid values in words; an interval up to the largest int32 has no upper end for a user."""
    if isinstance(valid, list):
        return f"{', '.join(valid[:-1])} or {valid[-1]}"
    low, _, high = valid[1:-1].partition(", ")
    return f"at least {low}" if high == str(2**31 - 1) else f"in {valid}"


def _wrap(text: str, indent: str = "") -> list[str]:
    return textwrap.wrap(text, WIDTH, initial_indent=indent, subsequent_indent=indent, break_on_hyphens=False)
