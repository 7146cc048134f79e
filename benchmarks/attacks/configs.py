"""Damaged values of config.json."""

import functools
import json

from benchmarks.attacks.case import Case, Failure, first, refused, require, unchanged
from benchmarks.attacks.place import Place

DIGITS = int("9" * 400)
BAD: dict[str, tuple] = {
    "env": ("", "x", 1, None, [], "../x", "sawyer_door", "tabletop_organization\n"),
    "env_options": (None, [], {"x": 1}, {"train_horizon": 3_000_000_000}, {"train_horizon": -1}, {"name": "x"}, {"__class__": 1}),
    "algo": ("", "x", 1, None, "naive", "../x"),
    "options": (None, [], {"x": 1}, {"name": "x"}, {"sac": 1}, {"discount": 2}, {"hidden_sizes": [0]}, {"hidden_sizes": DIGITS},
                {"precision": "fp4"}, {"batch_size": 1e308}, {"learning_rate": None}, {"hidden_sizes": [8]}),
    "seeds": ([], None, 5, ["0"], [0, 0], [-1], [DIGITS], [0.5], [[0]], {"0": 1}, [0], [0, 1, 2], "01", list(range(10**5))),
    "steps": (0, -120, None, "120", 1.5, DIGITS, 121, True, [120], 10**15, 40),
    "eval_every": (0, -1, None, "40", DIGITS, 7, 1.5),
    "eval_episodes": (0, -1, None, DIGITS, "2", 10**12),
    "checkpoint_every": (0, None, "x", -1),
    "setting": (None, {}, [], {"name": "x"}, {"name": "deployment", "x": 1}, {"name": None},
                {"name": "deployment", "budget": -1}),
    "logs": ("x", ["x"], [1], None, {"a": 1}, [["x"]], ["../x"]),
    "env_class": (1, "os:system", "x", "a:b", "../x:y"),
    "algo_class": (1, "os:system", "x", "a:b"),
    "id": (None, 1, [], "../../x"),
}  # fmt: skip
TEXTS = {
    "empty": "", "null": "null", "list": "[]", "number": "1", "text": '"x"', "NaN": "NaN", "half": None, "brackets": "[" * 5000,
    "objects": '{"a":' * 5000, "a million brackets": "[" * 10**6, "binary": "\0\1\2", "byte order mark": "\ufeff{}",
    "400 digits": '{"steps": ' + "9" * 400 + "}",
    "5000 digits": '{"steps": ' + "9" * 5000 + "}", "doubled key": '{"steps": 1, "steps": 2}', "comment": "// x\n{}",
}  # fmt: skip
COMMANDS = {"resume": ("resume", "run"), "table": ("table", "run"), "report": ("report", "run")}
EXPECTED = (
    "one line, exit code 2, the folder unchanged; or, if the value means nothing for the run, the identical table"
)


def attack(command: str, change, place: Place) -> str:
    """Damage the config of the unfinished run and expect one line, or a result that the damage does not touch."""
    folder = place.unfinished()
    file = folder / "config.json"
    file.write_text(change(file.read_text()), errors="surrogatepass")
    if command == "resume":
        with UnchangedUnlessLonger(folder):
            outcome = place.run("resume", folder, seconds=60)
        return first(lambda: refused(outcome), lambda: place.identical(outcome, folder))
    with unchanged(folder):
        outcome = place.run(*COMMANDS[command], seconds=60)
    if outcome.code == 0:
        require("Traceback" not in outcome.err, outcome, "no traceback")
        return "shown all the same"
    if command == "report" and "none of the runs can be shown" in outcome.err:
        require(outcome.code == 2 and "Traceback" not in outcome.err, outcome, "exit code 2 and the cause")
        return "refused with the cause"
    return refused(outcome)


class UnchangedUnlessLonger:
    """A context that expects an unchanged folder unless its table became longer."""

    def __init__(self, folder):
        self._folder, self._context = folder, unchanged(folder)

    def __enter__(self):
        self._size = (self._folder / "metrics.csv").stat().st_size
        self._context.__enter__()

    def __exit__(self, *error):
        try:
            self._context.__exit__(None, None, None)
        except Failure:
            if (self._folder / "metrics.csv").stat().st_size <= self._size:
                raise


def with_value(field: str, value, text: str) -> str:
    """Return the text of a config whose `field` is `value`."""
    return json.dumps({**json.loads(text), field: value})


def without(field: str, text: str) -> str:
    """Return the text of a config without `field`."""
    return json.dumps({name: value for name, value in json.loads(text).items() if name != field})


def replaced(new: str | None, text: str) -> str:
    """Return `new`, or half of the text."""
    return text[: len(text) // 2] if new is None else new


def cases() -> list[Case]:
    """Return a case for every damage and command: all with resume, some with the others."""
    changes = {
        f"{field} = {ascii(value)[:60]}": functools.partial(with_value, field, value)
        for field, values in BAD.items()
        for value in values
    }
    changes |= {
        f"without {field}": functools.partial(without, field) for field in ("env", "algo", "seeds", "steps", "options")
    }
    changes |= {f"text: {name}": functools.partial(replaced, text) for name, text in TEXTS.items()}
    listed = []
    for number, (name, change) in enumerate(changes.items()):
        commands = COMMANDS if number % 6 == 0 else ("resume",)
        listed += [
            Case(
                f"{command}: {name}", EXPECTED, functools.partial(attack, command, change),
                fast=command == "table" or (name.startswith("text: b") and command == "resume"),
            )
            for command in commands
        ]  # fmt: skip
    return listed
