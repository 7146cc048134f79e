"""Errors in a user's task, method or log keep their traceback, which names the line."""

import functools

from benchmarks.attacks import plugin
from benchmarks.attacks.case import Case, traceback_kept
from benchmarks.attacks.place import Place, train

EXPECTED = (
    "exit code 1 and a traceback with the error and the file of the plugin, not one line that looks like bad input"
)
TASK_PARTS = ("reset", "success", "reward", "sample_goal")
METHOD_PARTS = ("init_state", "phase_length", "reward", "update_state")


def task(part: str, kind: str, place: Place) -> str:
    """Train on a task with an error."""
    cls = plugin.erring_task("erring", part, kind)
    outcome = place.run(*train("run", task="erring"), before=functools.partial(plugin.install, task=cls))
    return traceback_kept(outcome, named(kind), "plugin.py")


def method(part: str, kind: str, place: Place) -> str:
    """Train by a method with an error."""
    cls = plugin.erring_method("erring", part, kind)
    outcome = place.run(*train("run", algo="erring"), before=functools.partial(plugin.install, method=cls))
    return traceback_kept(outcome, named(kind), "plugin.py")


def named(kind: str) -> str:
    """Return the name of an error as a traceback prints it."""
    return "FileNotFoundError" if kind == "OSError" else kind


def cases() -> list[Case]:
    """Return every error in `reward`, and one error in every other part."""
    return [
        *(
            Case(f"{kind} in a task's transition", EXPECTED, functools.partial(task, "transition", kind))
            for kind in plugin.ERRORS
        ),
        *(
            Case(f"ValueError in a task's {part}", EXPECTED, functools.partial(task, part, "ValueError"))
            for part in TASK_PARTS
        ),
        *(
            Case(f"OSError in a task's {part}", EXPECTED, functools.partial(task, part, "OSError"))
            for part in TASK_PARTS
        ),
        *(
            Case(f"{kind} in a method's next_goal", EXPECTED, functools.partial(method, "next_goal", kind))
            for kind in plugin.ERRORS
        ),
        *(
            Case(f"ValueError in a method's {part}", EXPECTED, functools.partial(method, part, "ValueError"))
            for part in METHOD_PARTS
        ),
    ]
