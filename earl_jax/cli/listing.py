"""The command that describes tasks, methods, learners and presets: list. It imports only classes of other packages."""

import dataclasses
import textwrap
from importlib.metadata import EntryPoint
from itertools import chain
from typing import Any

from earl_jax import assets
from earl_jax.cli.arguments import Positional, emit
from earl_jax.cli.descriptions import DESCRIBE, REGISTRIES, names, stored
from earl_jax.errors import InputError, choices
from earl_jax.options.presets import PRESETS
from earl_jax.options.registry import LEARNER, class_name
from earl_jax.options.values import LARGEST_INT, value_text

WIDTH = 80
LONGEST = 30
"""Number of letters that the overview reserves for a name; a longer name makes its own line longer."""
MORE = "earl-jax list NAME describes one of them with its options; --json prints all."
SCORES = ("seeds", "step", "episodes", "deployed/success", "deployed/return")
NOT_FACTS = ("name", "kind", "options", "learner", "shared", "details", "summary", "values", "policies")


def list_(name: Positional[str | None] = None, json: bool = False) -> None:
    """List the tasks, methods, learners and presets, including those of installed packages, or describe one of them.

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
        described["learner"] = {**stored()["shared"], **describe("learner", LEARNER)["options"]}
    if kind == "learner":
        described["shared"] = stored()["shared"]
    emit(described, json, _details(described))


def describe_all() -> dict[str, Any]:
    """Return the names of tasks (`envs`) and methods (`algos`), all descriptions, and the options of every learner."""
    known = names()
    described = {f"{kind}s": {name: describe(kind, name) for name in known[kind]} for kind in known}
    return {"envs": known["task"], "algos": known["method"], **described, "shared": stored()["shared"]}


def describe(kind: str, name: str) -> dict[str, Any]:
    """Return the description of a task, method or learner (sizes or source, policies, options), or a preset's schedule.

    The steps of a preset are None if they are the paper's for the task. A task, method or learner whose class cannot be
    loaded, or that several packages claim, has the key `error` instead.
    """
    if kind == "preset":
        preset = PRESETS[name]
        schedule = dataclasses.asdict(preset.schedule) | ({"steps": None} if preset.published_steps else {})
        own = {"summary": preset.summary, "seeds": preset.seeds, **schedule, "values": preset.options}
        return {"kind": kind, "name": name, **own}
    head: dict[str, Any] = {"kind": kind, "name": name, "package": ""}
    try:
        target, head["package"] = REGISTRIES[kind].locate(name)
        path = target.value if isinstance(target, EntryPoint) else class_name(target)
        head |= {"class": path, "policies": _policies(name)}
        if path in stored():
            return head | stored()[path]
        return head | DESCRIBE[kind](name)
    except Exception as error:  # the code of another package
        return head | {"error": str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"}


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


def _overview(everything: dict[str, Any]) -> str:
    """Return a line for each task and each method, and the names of learners and presets."""
    lines = []
    for kind in ("tasks", "methods"):
        size = min(max(10, *map(len, everything[kind])), LONGEST)
        for number, described in enumerate(everything[kind].values()):
            package = described.get("package", "earl_jax")
            summary = described.get("error") or described["summary"] + f" From {package}." * (package != "earl_jax")
            start = f"{kind if number == 0 else '':<9}{described['name']:<{size}}  "
            room = max(WIDTH - len(start), WIDTH // 4)
            lines.append(start + textwrap.shorten(summary, room, placeholder="..."))
        lines.append("")
    lines += [f"{kind:<9}{', '.join(everything[kind])}" for kind in ("learners", "presets")]
    return "\n".join([*lines, MORE])


def _details(described: dict[str, Any]) -> str:
    """Return the whole description of one name as text."""
    facts = {key.replace("_", " "): _number(value) for key, value in described.items() if key not in NOT_FACTS}
    facts |= {"steps": facts["steps"] or "published"} if described["kind"] == "preset" else {}
    lines = [f"{described['name']} ({described['kind']})", "", *_wrap(described.get("summary", "")), ""]
    for key, value in {**facts, **described.get("values", {})}.items():
        lines += textwrap.wrap(_cell(value), WIDTH, initial_indent=f"{key:<22}", subsequent_indent=" " * 22)
    for paragraph in described.get("details", []):
        lines += ["", *_wrap(paragraph)] if paragraph != described["summary"] else []
    lines += _policies_text(described)
    lines += _options_text("options", described.get("options"))
    lines += _options_text(f"options of the learner {LEARNER}; --learner takes another", described.get("learner"))
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
        default = "null" if option["default"] is None else _cell(option["default"])
        lines += _wrap(f"{name}={default}  ({option['type']}{among})", "  ")
        lines += _wrap(option["meaning"], "      ")
    return lines


def _cell(value: Any) -> str:
    """Return `value` in the form in which a user would write it."""
    if value is None or value == []:
        return "none"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list | tuple):
        return ", ".join(value) if isinstance(value[0], str) else f"[{', '.join(map(_cell, value))}]"
    return value_text(value)


def _number(value: Any) -> Any:
    """Return a whole number of five digits or more with separators, and any other value as it is."""
    return f"{value:,}" if isinstance(value, int) and value >= 10_000 else value


def _valid_text(valid: list[str] | str) -> str:
    """Return the valid values in words; an interval up to the largest int32 is shown without an upper end."""
    if isinstance(valid, list):
        return f"{', '.join(valid[:-1])} or {valid[-1]}"
    low, _, high = valid[1:-1].partition(", ")
    return f"at least {low}" if high == str(LARGEST_INT) else f"in {valid}"


def _wrap(text: str, indent: str = "") -> list[str]:
    return textwrap.wrap(text, WIDTH, initial_indent=indent, subsequent_indent=indent, break_on_hyphens=False)
