"""Damaged tables of metrics, read by every command that needs them."""

import functools
from collections.abc import Callable
from pathlib import Path

from benchmarks.attacks.case import Case, Failure, first, refused, require, unchanged
from benchmarks.attacks.place import Place

EXPECTED = {
    "resume unfinished": "one line and nothing changed, or the identical numbers at the end",
    "resume finished": "one line and nothing changed, or the identical numbers",
    "table": "one line, or a table",
    "plot": "one line, or a picture",
    "report": "one line, or a page that names the run",
}


def lines_of(text: str) -> list[str]:
    """Return the lines of a table with their ends."""
    return text.splitlines(keepends=True)


def edited(edit: Callable[[list[str]], list[str]], text: str) -> str:
    """Return a table whose lines went through `edit`."""
    return "".join(edit(lines_of(text)))


def with_cell(row: int, column: int, value: str, text: str) -> str:
    """Return a table with another value in one cell."""
    rows = [line.rstrip("\n").split(",") for line in lines_of(text)]
    rows[row][column] = value
    return "".join(",".join(cells) + "\n" for cells in rows)


DAMAGES: dict[str, Callable[[str], str]] = {
    "empty": lambda text: "",
    "only a line end": lambda text: "\n",
    "only the header": functools.partial(edited, lambda lines: lines[:1]),
    "carriage returns only": lambda text: text.replace("\n", "\r"),
    "line ends of Windows": lambda text: text.replace("\n", "\r\n"),
    "byte order mark": lambda text: "\ufeff" + text,
    "a row twice": functools.partial(edited, lambda lines: [*lines[:2], lines[1], *lines[2:]]),
    "all rows twice": functools.partial(edited, lambda lines: [*lines, *lines[1:]]),
    "a row missing": functools.partial(edited, lambda lines: lines[:2] + lines[3:]),
    "an evaluation missing": functools.partial(edited, lambda lines: lines[:1] + lines[3:]),
    "the last row missing": functools.partial(edited, lambda lines: lines[:-1]),
    "the last row cut": lambda text: text[:-9],
    "the last evaluation missing": functools.partial(edited, lambda lines: lines[:-2]),
    "rows in another order": functools.partial(edited, lambda lines: lines[:1] + lines[:0:-1]),
    "no header": functools.partial(edited, lambda lines: lines[1:]),
    "another header": functools.partial(edited, lambda lines: ["a,b,c\n", *lines[1:]]),
    "a header with two equal names": functools.partial(
        edited, lambda lines: [lines[0].replace("seed", "step"), *lines[1:]]
    ),
    "a column missing": functools.partial(edited, lambda lines: [line.rpartition(",")[0] + "\n" for line in lines]),
    "a column more": functools.partial(edited, lambda lines: [line[:-1] + ",1\n" for line in lines]),
    "a row too long": functools.partial(edited, lambda lines: [lines[0], lines[1][:-1] + ",1,2,3\n", *lines[2:]]),
    "a row too short": functools.partial(edited, lambda lines: [lines[0], "40,0\n", *lines[2:]]),
    "other seeds": functools.partial(with_cell, 1, 1, "7"),
    "a seed that is no number": functools.partial(with_cell, 1, 1, "x"),
    "a seed of a fraction": functools.partial(with_cell, 1, 1, "0.5"),
    "another step": functools.partial(with_cell, 1, 0, "41"),
    "a step of NaN": functools.partial(with_cell, 1, 0, "nan"),
    "a negative step": functools.partial(with_cell, 1, 0, "-40"),
    "a step of 400 digits": functools.partial(with_cell, 1, 0, "9" * 400),
    "a step of 5000 digits": functools.partial(with_cell, 1, 0, "9" * 5000),
    "text in a cell": functools.partial(with_cell, 2, 3, "<script>"),
    "an open quote": functools.partial(with_cell, 2, 3, '"'),
    "binary": lambda text: text.replace("0", "\0"),
    "bytes that are no text": lambda text: text.replace("0", "\udcff", 3),
}


def write(folder: Path, damage: Callable[[str], str]) -> None:
    """Damage the table of a run folder."""
    file = folder / "metrics.csv"
    file.write_bytes(damage(file.read_text()).encode(errors="surrogateescape"))


def attack(command: str, damage: Callable[[Path], object], place: Place) -> str:
    """Damage a table, run a command, and expect one line or the right result."""
    folder = place.unfinished() if command == "resume unfinished" else place.finished()
    damage(folder)
    if command.startswith("resume"):
        return _resume(place, folder)
    out = {"table": place.path / "table.md", "plot": place.path / "plot.png", "report": place.path / "report.html"}[
        command
    ]
    with unchanged(folder):
        outcome = place.run(command, folder, "--out", out)
    if outcome.code:
        if out.exists():
            raise Failure("an output was written in spite of the error")
        return first(lambda: refused(outcome), lambda: _causes(outcome))
    require(out.stat().st_size > 0 and "Traceback" not in outcome.err, outcome, "an output")
    if command == "report" and "<script>," in out.read_text():
        raise Failure("text of the table is code on the page")
    return "shown"


def _causes(outcome) -> str:
    require(outcome.code == 2 and "Traceback" not in outcome.err, outcome, "exit code 2 and the cause")
    require("none of the runs can be shown" in outcome.err, outcome, "the cause for each run")
    return "refused with the cause"


def _resume(place: Place, folder: Path) -> str:
    before = (folder / "metrics.csv").read_bytes() if (folder / "metrics.csv").is_file() else None
    outcome = place.run("resume", folder)
    if outcome.code == 0:
        return first(lambda: place.identical(outcome, folder), lambda: _equal_columns(place, folder))
    after = (folder / "metrics.csv").read_bytes() if (folder / "metrics.csv").is_file() else None
    if before != after:
        raise Failure("refused, but the table was changed")
    return refused(outcome)


def _equal_columns(place: Place, folder: Path) -> str:
    """Expect that a run which keeps the columns of its table has the right numbers in all that it should have."""
    kept, whole = (_columns(text) for text in ((folder / "metrics.csv").read_text(), place.whole.decode()))
    shared = kept.keys() & whole.keys()
    if (
        len(shared) < len(whole) - 1
        or not {"step", "seed"} <= shared
        or any(kept[name] != whole[name] for name in shared)
    ):
        raise Failure("finished with other numbers")
    return "finished with the same numbers in the columns of its table"


def _columns(text: str) -> dict[str, tuple[str, ...]]:
    names, *rows = (line.split(",") for line in text.splitlines())
    return dict(zip(names, zip(*rows, strict=True), strict=True))


def remove(folder: Path) -> None:
    """Remove the table."""
    (folder / "metrics.csv").unlink()


def make_folder(folder: Path) -> None:
    """Put a folder in the place of the table."""
    remove(folder)
    (folder / "metrics.csv").mkdir()


def cases() -> list[Case]:
    """Return a case for every damage and command."""
    damages: dict[str, Callable[[Path], object]] = {"missing": remove, "a folder": make_folder}
    damages |= {name: functools.partial(write, damage=damage) for name, damage in DAMAGES.items()}
    return [
        Case(
            f"{command}: {name}", expected, functools.partial(attack, command, damage),
            fast=command == "table" and number % 3 == 0,
        )
        for number, (name, damage) in enumerate(damages.items())
        for command, expected in EXPECTED.items()
    ]  # fmt: skip
