"""metrics.csv: rows in the order in which a run writes them, so that missing, repeated and foreign rows are detected.

There is a row for each seed at each evaluation, in the order of the config's seeds.
"""

import csv
import dataclasses
import io
from collections.abc import Iterator, Sequence
from pathlib import Path

from earl_jax.errors import InputError
from earl_jax.runs.config import Row, RunConfig
from earl_jax.runs.files import read_again, read_bytes

KEYS = {"step", "seed"}
COLUMNS = {
    *("deployed/success", "deployed/return", "continuing/reward", "continuing/recent"),
    *("interventions", "faults", "reached"),
}
"""Metrics that every run writes; others depend on the task, the method and the release."""


@dataclasses.dataclass(frozen=True)
class Table:
    """A table of metrics as far as it is intact.

    `columns` are the names in its header. `lines` are its complete lines, the header first. `rows` are those of whole
    evaluations before the first error, which `problem` describes; it is empty if there is none. The last evaluation is
    no error if a kill truncated it.
    """

    columns: tuple[str, ...]
    lines: tuple[str, ...]
    rows: list[Row]
    problem: str
    step: int
    """The last evaluation of `rows`."""

    @classmethod
    def read(cls, path: Path, config: RunConfig) -> "Table":
        """Return the table at `path`, which is empty if there is no file."""
        lines = complete_lines(path)
        columns, rows, problem = _intact_rows(lines, config)
        seeds = len(config.seeds)
        evaluations = len(rows) // seeds
        return cls(tuple(columns), tuple(lines), rows[: evaluations * seeds], problem, evaluations * config.eval_every)


def table_text(path: Path) -> str:
    """Return the text of the table at `path`, with the line ends of Unix, or "" if there is no file."""
    text = read_bytes(path).decode("utf-8-sig", errors="replace") if path.exists() else ""
    return text.replace("\r\n", "\n").replace("\r", "\n")


def complete_lines(path: Path) -> list[str]:
    """Return the lines of the table at `path` that end, without blank ones."""
    return [line for line in table_text(path).split("\n")[:-1] if line.strip()]


def columns_of(path: Path) -> list[str]:
    """Return the columns of the table at `path`, of which only the start is read; [] without a complete header."""

    def first_line() -> str:
        with path.open(encoding="utf-8-sig", errors="replace") as handle:
            return next((line for line in handle if line.strip()), "")

    line = read_again(first_line)
    return cells(line) if line.endswith("\n") else []


def cells(line: str) -> list[str]:
    """Return the cells of a line."""
    return next(csv.reader([line]))


def csv_text(rows: Sequence[Row], columns: Sequence[str]) -> str:
    """Return the lines of `rows` under existing `columns`, or with a header of their own if there are none.

    Raises:
        ValueError: a column is not among the values of the rows.
    """
    foreign = [name for name in columns if name not in rows[0]]
    if foreign:
        raise InputError(f"it has columns that this run does not write: {', '.join(foreign)}")
    text = io.StringIO()
    names = columns or list(rows[0])
    writer = csv.DictWriter(text, names, extrasaction="ignore", lineterminator="\n")
    if not columns:
        writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def _intact_rows(lines: Sequence[str], config: RunConfig) -> tuple[list[str], list[Row], str]:
    """Return the columns, the rows up to the first that is not as it must be, and what is wrong with that one."""
    columns: list[str] = []
    rows: list[Row] = []
    try:
        columns = cells(lines[0]) if lines else []
        if lines and (not set(columns) >= KEYS or len(set(columns)) < len(columns)):
            return columns, [], "line 1 is not the header"
        for number, (line, (step, seed)) in enumerate(zip(lines[1:], _expected(config), strict=False), 2):
            row = _row(columns, cells(line))
            if row is None:
                return columns, rows, f"line {number} is not a row of numbers"
            if (row["step"], row["seed"]) != (step, seed):
                actual = f"step {row['step']} of seed {row['seed']}"
                return columns, rows, f"line {number} is {actual} instead of step {step} of seed {seed}"
            rows.append(row)
    except csv.Error as error:
        return columns, rows, f"line {len(rows) + 2} cannot be read ({error})"
    if len(lines) - 1 > len(rows):
        return columns, rows, f"line {len(rows) + 2} comes after step {config.steps}, the last one of the run"
    return columns, rows, ""


def _expected(config: RunConfig) -> Iterator[tuple[int, int]]:
    """Yield step and seed of each row of a whole run."""
    for step in range(config.eval_every, config.steps + 1, config.eval_every):
        for seed in config.seeds:
            yield step, seed


def _row(columns: Sequence[str], texts: Sequence[str]) -> Row | None:
    """Return the row of `texts`, or None if there are others than one number for each column."""
    if len(texts) != len(columns):
        return None
    try:
        return {name: _number(text) for name, text in zip(columns, texts, strict=True)}
    except ValueError:
        return None


def _number(text: str) -> float:
    is_integer = text.lstrip("-").isdigit() and len(text) < 19  # a longer one fits in no array
    return int(text) if is_integer else float(text)
