"""metrics.csv: rows in the order in which a run writes them, so that missing, repeated and foreign rows are detected.

There is a row for each seed at each evaluation, in the order of the config's seeds.
"""

import contextlib
import csv
import dataclasses
import io
from collections.abc import Iterator, Sequence
from pathlib import Path

from earl_jax.errors import InputError
from earl_jax.runs.config import Row, RunConfig
from earl_jax.runs.files import opened, read_bytes

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

    @property
    def step(self) -> int:
        """The last evaluation of `rows`, or 0."""
        return int(self.rows[-1]["step"]) if self.rows else 0

    @classmethod
    def read(cls, path: Path, config: RunConfig) -> "Table":
        """Return the table at `path`, which is empty if there is no file."""
        lines = [line for line in table_text(path).split("\n")[:-1] if line.strip()]
        columns: list[str] = []
        rows: list[Row] = []
        problem = ""
        try:
            columns = _header(lines[0]) if lines else []
            for line, (step, seed) in zip(lines[1:], _expected(config), strict=False):
                rows.append(_row(columns, line, step, seed))
            if len(lines) - 1 > len(rows):
                raise InputError(f"comes after step {config.steps}, the last one of the run")
        except InputError as error:
            problem = f"line {len(rows) + 2 if columns else 1} {error}"
        return cls(tuple(columns), tuple(lines), rows[: len(rows) - len(rows) % len(config.seeds)], problem)


def table_text(path: Path) -> str:
    """Return the text of the table at `path`, with the line ends of Unix, or "" if there is no file."""
    try:
        text = read_bytes(path).decode("utf-8-sig", errors="replace")
    except FileNotFoundError:
        return ""
    return text.replace("\r\n", "\n").replace("\r", "\n")


def columns_of(path: Path) -> list[str]:
    """Return the columns of the table at `path`, of which only the start is read; [] without a complete header."""
    with contextlib.suppress(FileNotFoundError), opened(path) as handle:
        line = next((line for line in handle if line.strip()), b"").decode(errors="replace")
        return cells(line) if line.endswith("\n") else []
    return []


def cells(line: str) -> list[str]:
    """Return the cells of a line.

    Raises:
        ValueError: it cannot be read, because a cell is too long.
    """
    try:
        return next(csv.reader([line]))
    except csv.Error as error:
        raise InputError(f"cannot be read ({error})") from error


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


def _header(line: str) -> list[str]:
    columns = cells(line)
    if not set(columns) >= KEYS or len(set(columns)) < len(columns):
        raise InputError("is not the header")
    return columns


def _expected(config: RunConfig) -> Iterator[tuple[int, int]]:
    """Yield step and seed of each row of a whole run."""
    for step in range(config.eval_every, config.steps + 1, config.eval_every):
        for seed in config.seeds:
            yield step, seed


def _row(columns: Sequence[str], line: str, step: int, seed: int) -> Row:
    """Return the row on a line; raise an InputError that says why it is not a row of numbers of `step` and `seed`."""
    texts = cells(line)
    try:
        row = {name: _number(text) for name, text in zip(columns, texts, strict=True)}
    except ValueError as error:
        raise InputError("is not a row of numbers") from error
    if (row["step"], row["seed"]) != (step, seed):
        raise InputError(f"is step {row['step']} of seed {row['seed']} instead of step {step} of seed {seed}")
    return row


def _number(text: str) -> float:
    is_integer = text.lstrip("-").isdigit() and len(text) < 19  # a longer one fits in no array
    return int(text) if is_integer else float(text)
