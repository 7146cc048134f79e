"""metrics.csv: rows in the order in which a run writes them, so that missing, repeated and foreign rows are detected.

There is a row for each seed at each evaluation, in the order of the config's seeds.
"""

import contextlib
import csv
import dataclasses
import io
import itertools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from earl_jax.errors import InputError
from earl_jax.metrics.scores import RATES
from earl_jax.runs.config import RunConfig
from earl_jax.runs.files import opened

KEYS = ("step", "seed")
COLUMNS = {
    *("deployed/success", "deployed/return", "continuing/reward", "continuing/recent"),
    *("interventions", "faults", "reached"),
}
"""Metrics that every run writes; others depend on the task, the method and the release."""
LONGEST = 1 << 16
"""Letters of a line; a longer line is cut, is not a row and is the last line read, so that files use little memory."""
BLOCK = 4096
"""Lines that are parsed together."""


@dataclasses.dataclass(frozen=True, eq=False)
class Table:
    """A table of metrics as far as it is intact.

    `steps [E]` and `metrics` of arrays [N, E] are those of the whole evaluations before the first error, which `problem`
    describes; it is empty if there is none. The last evaluation is no error if a kill truncated it; then the table is `cut`.
    Without an evaluation there are no metrics.
    """

    steps: np.ndarray = dataclasses.field(default_factory=lambda: np.empty(0, int))
    metrics: dict[str, np.ndarray] = dataclasses.field(default_factory=dict)
    problem: str = ""
    cut: bool = False

    @property
    def step(self) -> int:
        """The step of the last evaluation, or 0."""
        return int(self.steps[-1]) if len(self.steps) else 0

    def until(self, step: int) -> "Table":
        """Return the table without the evaluations after `step`."""
        count = int(np.searchsorted(self.steps, step, side="right"))
        metrics = {name: values[:, :count] for name, values in self.metrics.items()}
        return dataclasses.replace(self, steps=self.steps[:count], metrics=metrics)

    def extended(self, step: int, metrics: Mapping[str, np.ndarray]) -> "Table":
        """Return the table with the `metrics [N]` of a further evaluation in its columns or, without any, in theirs."""
        earlier = self.metrics or {name: np.empty((len(values), 0)) for name, values in metrics.items()}
        longer = {name: np.column_stack([values, metrics[name]]) for name, values in earlier.items()}
        return dataclasses.replace(self, steps=np.append(self.steps, step), metrics=longer)

    @classmethod
    def read(cls, path: Path, config: RunConfig) -> "Table":
        """Return the table at `path`, which is empty if there is no file."""
        lines, seeds = lines_of(path), len(config.seeds)
        header = next(lines, "")
        columns = _cells(header) if _is_whole(header) else []
        if not set(columns) >= set(KEYS) or len(set(columns)) < len(columns):
            return cls(problem="line 1 is not the header, names with commas between them" if columns else "")
        blocks, count, problem, cut = [np.empty((0, len(columns)))], 0, "", False
        while not problem and not cut and (block := list(itertools.islice(lines, BLOCK))):
            cut = not _is_whole(block[-1])
            rows, problem = _rows(block[:-1] if cut else block, columns, config, count)
            blocks.append(rows)
            count += len(rows)
        problem = problem and f"line {count + 2} {problem}"
        cut |= bool(count % seeds)
        if count < seeds:
            return cls(problem=problem, cut=cut)
        values = np.concatenate(blocks)[: count - count % seeds].reshape(-1, seeds, len(columns))
        metrics = dict(zip(columns, np.ascontiguousarray(values.transpose(2, 1, 0)), strict=True))
        steps, _ = (metrics.pop(name) for name in KEYS)
        return cls(steps[0].astype(int), metrics, problem or _not_a_rate(steps[0], metrics, config), cut)


def _not_a_rate(steps: np.ndarray, metrics: Mapping[str, np.ndarray], config: RunConfig) -> str:
    """Return where the deployed score is a rate outside [0, 1], as of a run from elsewhere in percent; else an empty text."""
    name = config.deployed_metric
    if name not in RATES or name not in metrics:
        return ""
    values = metrics[name]
    wrong = (values < 0) | (values > 1)
    if not wrong.any():
        return ""
    lane, row = np.argwhere(wrong)[0]
    return f"{name} of seed {config.seeds[lane]} at step {steps[row]:.0f} is {values[lane, row]:g}, not from 0 to 1"


def lines_of(path: Path) -> Iterator[str]:
    """Yield the lines of the table at `path` that are not blank, with the line ends of Unix; none if there is no file."""
    with contextlib.suppress(FileNotFoundError), opened(path) as handle:
        text = io.TextIOWrapper(handle, encoding="utf-8-sig", errors="replace")
        line = "\n"
        while line.endswith("\n"):
            line = text.readline(LONGEST)
            if line.strip() or len(line) == LONGEST:
                yield line


def whole_lines(path: Path) -> Iterator[str]:
    """Yield the lines of `lines_of` without the last one if a kill truncated it."""
    return filter(_is_whole, lines_of(path))


def columns_of(path: Path) -> list[str]:
    """Return the columns of the table at `path`, of which only the start is read; [] without a complete header."""
    return _cells(next(whole_lines(path), ""))


def csv_text(step: int, seeds: Sequence[int], metrics: Mapping[str, np.ndarray], columns: Sequence[str]) -> str:
    """Return the rows of `metrics [N]` under existing `columns`, or with a header of their own if there are none.

    Raises:
        ValueError: a column is not among the values of the rows.
    """
    values = {"step": [step] * len(seeds), "seed": seeds, **{name: array.tolist() for name, array in metrics.items()}}
    foreign = [name for name in columns if name not in values]
    if foreign:
        raise InputError(f"it has columns that this run does not write: {', '.join(foreign)}")
    text = io.StringIO()
    names = columns or list(values)
    writer = csv.writer(text, lineterminator="\n")
    writer.writerows([] if columns else [names])
    writer.writerows(zip(*(values[name] for name in names), strict=True))
    return text.getvalue()


def _is_whole(line: str) -> bool:
    return line.endswith("\n") or len(line) == LONGEST


def _cells(line: str) -> list[str]:
    return next(csv.reader([line]), [])


def _rows(lines: Sequence[str], columns: Sequence[str], config: RunConfig, count: int) -> tuple[np.ndarray, str]:
    """Return the rows [R, C] on `lines`, which follow `count` others, before the first error, and what it is."""
    rows = _numbers(lines, len(columns))
    index = np.arange(count, count + len(rows))
    steps = config.eval_every * (index // len(config.seeds) + 1)
    expected = np.stack([steps, np.array(config.seeds)[index % len(config.seeds)]], axis=1)
    found = rows[:, [columns.index(name) for name in KEYS]]
    wrong = np.flatnonzero((found != expected).any(axis=1) | (steps > config.steps))
    if not len(wrong):
        return rows, "" if len(rows) == len(lines) else "is not a row of numbers"
    first = wrong[0]
    if steps[first] > config.steps:
        return rows[:first], f"comes after step {config.steps}, the last one of the run"
    (step, seed), (wanted, of_seed) = found[first], expected[first]
    order = "rows go by step, and of a step in the order of the config's seeds"
    return rows[:first], f"is step {step:.15g} of seed {seed:.15g} instead of step {wanted} of seed {of_seed} ({order})"


def _numbers(lines: Sequence[str], width: int) -> np.ndarray:
    """Return the rows [R, width] on `lines` before the first that does not have as many numbers."""
    if not lines:
        return np.empty((0, width))
    with contextlib.suppress(ValueError):
        rows = np.loadtxt(lines, delimiter=",", comments=None, ndmin=2)
        if rows.shape[1] == width:
            return rows
    if len(lines) == 1:
        return np.empty((0, width))
    each = (_numbers([line], width) for line in lines)
    return np.concatenate([np.empty((0, width)), *itertools.takewhile(len, each)])
