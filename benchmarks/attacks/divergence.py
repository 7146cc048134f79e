"""Numbers that are not finite: in options, rewards, observations and parameters."""

import csv
import functools
import math
from pathlib import Path

from benchmarks.attacks import plugin
from benchmarks.attacks.case import Case, Failure, first, refused, refused_arguments, require
from benchmarks.attacks.place import Place, train

MARKED = "a column `diverged` that says so at the end, for each such seed, or one line that refuses the value"
FAULTS = "finite losses and returns, and faults counted"
VALUES = {"NaN": math.nan, "infinity": math.inf, "minus infinity": -math.inf}


def rows_of(folder: Path) -> list[dict[str, float]]:
    """Return the rows of a table of metrics."""
    with (folder / "metrics.csv").open() as handle:
        return [{name: float(value) for name, value in row.items()} for row in csv.DictReader(handle)]


def finite(row: dict[str, float]) -> bool:
    """Return whether losses and scores of a row are finite."""
    return all(math.isfinite(value) for value in row.values())


def option(text: str, place: Place) -> str:
    """Train with an option that makes numbers overflow."""
    outcome = place.run(*train("run", text))
    if outcome.code == 2:
        return refused_arguments(outcome)
    require(outcome.code == 0, outcome, "a finished run or one line")
    return _marked(place, outcome)


def _marked(place: Place, outcome) -> str:
    rows = rows_of(place.path / "run")
    if all(map(finite, rows)) and not any(row.get("diverged") for row in rows):
        return "finite throughout"
    last = [row for row in rows if row["step"] == rows[-1]["step"]]
    if not any(row.get("diverged") for row in last):
        raise Failure("numbers that are not finite, and no seed is marked as diverged")
    require("diverged" in outcome.out + outcome.err, outcome, "the word diverged on the screen")
    table = place.run("table", "run")
    require("diverged" in table.out, table, "the word diverged in the table")
    return "marked as diverged"


def one_lane(value: str, place: Place) -> str:
    """Train two seeds, one with an infinite bonus: the other one must not change."""

    def before() -> None:
        plugin.install(method=plugin.Bonus)

    sound = place.run(*train("sound", "bonus=[0,0]", algo="bonus"), before=before)
    require(sound.code == 0, sound, "a finished run")
    outcome = place.run(*train("run", f"bonus=[0,{value}]", algo="bonus"), before=before)
    if outcome.code == 2:
        return refused(outcome)
    require(outcome.code == 0, outcome, "a finished run")
    kept = [[line for line in (place.path / name / "metrics.csv").read_text().splitlines() if line.split(",")[1] != "1"]
            for name in ("sound", "run")]  # fmt: skip
    if kept[0] != kept[1]:
        raise Failure("the rows of the other seed differ")
    how = _marked_one(place)
    return f"{how}, the other seed bit-identical"


def _marked_one(place: Place) -> str:
    rows = rows_of(place.path / "run")
    marks = [bool(row.get("diverged")) for row in rows[-2:]]
    if marks != [False, True] and not all(map(finite, rows)):
        raise Failure(f"marked as diverged: {marks}, wanted the second seed")
    return "marked as diverged" if marks[1] else "finite throughout"


def task(make, name: str, value: float, more: tuple[str, ...], place: Place) -> str:
    """Train on a task whose numbers are not finite in places."""
    cls = make(name, value)
    outcome = place.run(*train("run", *more, task=name), before=lambda: plugin.install(task=cls))
    require(outcome.code == 0, outcome, "a finished run")
    rows = rows_of(place.path / "run")
    if not all(map(finite, rows)):
        raise Failure(
            f"not finite: {', '.join(key for row in rows for key, value in row.items() if not math.isfinite(value))}"[
                :200
            ]
        )
    if not any(row["faults"] for row in rows):
        raise Failure("no fault was counted")
    return "counted as faults, all metrics finite"


def report(place: Place) -> str:
    """Expect that table, plot and report of a diverged run work and name it."""
    before = functools.partial(plugin.install, method=plugin.Bonus)
    outcome = place.run(*train("run", "bonus=[0,1e300]", algo="bonus"), before=before)
    if outcome.code == 2:
        return refused(outcome)
    for command, out in (("table", "table.md"), ("plot", "plot.png"), ("report", "page.html")):
        outcome = place.run(command, "run", "--out", out, before=before)
        require(outcome.code == 0, outcome, f"a {command}")
    if "diverged" not in (place.path / "page.html").read_text():
        raise Failure("the page does not name the diverged seed")
    return first(lambda: "shown as diverged")


def cases() -> list[Case]:
    """Return options, seeds, tasks and reports with numbers that are not finite."""
    options = (
        "learning_rate=1e308", "learning_rate=1e38", "learning_rate=1e10", "initial_temperature=-1", "initial_temperature=0",
        "initial_temperature=1e308", "reward_scale=1e308", "reward_scale=-1e308", "discount=0.9999999999999999",
        "target_entropy=1e308", "tau=0", "tau=2", "learning_rate=[1e-3,1e30]",
    )  # fmt: skip
    tasks = [
        Case(f"{name}: {label}", FAULTS, functools.partial(task, make, f"{make.__name__}_task", value, more))
        for name, make, more in (
            ("reward", plugin.nan_reward, ("reward_type=dense",)),
            ("observation", plugin.nan_state, ()),
        )
        for label, value in VALUES.items()
    ]
    lanes = [
        Case(
            f"a bonus of {value} for one seed",
            f"{MARKED}; the other seed bit-identical",
            functools.partial(one_lane, value),
        )
        for value in ("1e30", "1e38", "-1e38", "1e300")
    ]
    return [
        *(Case(f"--set {text}", MARKED, functools.partial(option, text)) for text in options),
        *lanes,
        *tasks,
        Case("table, plot and report of a diverged run", "all three work, and the page names it", report),
    ]
