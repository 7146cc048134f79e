"""Tables: the rows of run folders, and any rows as markdown, LaTeX, csv or text for a terminal."""

import csv
import functools
import io
import math
import shutil
import sys
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from earl_jax.metrics.continuing import diverged_text
from earl_jax.metrics.crossings import CROSSING_WINDOW
from earl_jax.metrics.scores import DEFAULT, Window
from earl_jax.metrics.statistics import STDERR_RULE, Estimate
from earl_jax.report.pooling import read_all
from earl_jax.report.runs import Curves, checked_labels, labels, options_text
from earl_jax.report.scores import LEVELS, interval_of, row_of, seed_scores
from earl_jax.report.style import task_order
from earl_jax.runs.files import require_suffix, written

Row = dict[str, Any]
Column = tuple[str, Callable[[Row], Any]]
"""The heading of a column, and the function that gives its cell of a row."""
LATEX = str.maketrans(
    {letter: f"\\{letter}" for letter in "%&_#${}"}
    | {letter: f"${letter}$" for letter in "<>|"}  # LaTeX's own encoding prints < as an inverted !
    | {"\\": r"\textbackslash{}", "^": r"\textasciicircum{}", "~": r"\textasciitilde{}", "−": "$-$"}
)
"""What stands in LaTeX for the letters that have a meaning there."""
TABLES = (".md", ".tex", ".csv")
"""The suffixes of files that `write` writes."""
INTERVALS = (
    "Intervals of 95 % over seeds: Student's, or Wilson's with the effective number of trials for rates; fewer than three seeds "
    "have none, nor have equal rewards per step."
)
UNITS = ((1e9, "B"), (1e6, "M"), (1e3, "k"))
"""The units of numbers of steps in short."""
GAP = "  "
EMPTY = {"", "-"}


class Table(NamedTuple):
    """A table as text: its header, lines of cells, and notes."""

    header: Sequence[str]
    lines: Sequence[Sequence[Any]]
    notes: Sequence[str] = ()

    @classmethod
    def of(cls, columns: Sequence[Column], rows: Sequence[Row], notes: Sequence[str] = ()) -> "Table":
        """Return the table that has a line for each of `rows`."""
        return cls([name for name, _ in columns], [[cell(row) for _, cell in columns] for row in rows], notes)

    def text(self, width: int | None = None) -> str:
        """Return the table with its notes below, for a terminal of `width` columns, or as markdown without a width."""
        table = markdown_table(self.header, self.lines) if width is None else self._shown(width)
        notes = "\n".join(wrapped(note, width) for note in self.notes)
        return f"{table}\n\n{notes}"

    def latex(self) -> str:
        """Return the table as a LaTeX `tabular` for the package booktabs, with the notes above it as comments."""
        notes = [f"% {line}" for note in self.notes for line in textwrap.wrap(note, 100)]
        lines = (self.header, *self.lines)
        head, *rows = [" & ".join(str(cell).translate(LATEX) for cell in line) + r" \\" for line in lines]
        head = [r"\begin{tabular}{" + "l" * len(self.header) + "}", r"\toprule", head, r"\midrule"]
        return "\n".join([*notes, *head, *rows, r"\bottomrule", r"\end{tabular}"])

    def _shown(self, width: int) -> str:
        """Return the table in `width` columns, or where it is wider, each row as a block with a line for each of its cells."""
        lines = [[str(cell) for cell in line] for line in (self.header, *self.lines)]
        kept = [i for i in range(len(self.header)) if i == 0 or any(row[i] not in EMPTY for row in lines[1:])]
        names, *rows = [[line[i] for i in kept] for line in lines]
        sizes = [max(map(len, column)) for column in zip(names, *rows, strict=True)]
        if sum(sizes) + len(GAP) * (len(sizes) - 1) > width:
            return "\n\n".join(_block(names, row, width) for row in rows)
        return "\n".join(GAP.join(map(str.ljust, line, sizes)).rstrip() for line in (names, *rows))


def tabulate(
    folders: Sequence[str | Path], window: Window = DEFAULT, metric: str | None = None, names: Sequence[str] = ()
) -> list[Row]:
    """Return one row per method: deployed and continuing scores over seeds, crossings, and the published scores.

    The tasks are in the paper's order, the rows of a task in the order of its folders.

    Args:
        folders: run folders; seeds of the same task, method and options are pooled.
        window: the evaluations at the end of a run that are averaged; the paper's table 1 uses the last one alone.
        metric: a column of metrics.csv; rows then contain only its mean and interval.
        names: a name for each row, in the order of the folders; by default its method, with the options that
            distinguish it from others.

    Raises:
        ValueError: a folder cannot be read, a run has no column `metric`, or `names` are too few or many.
    """
    runs = read_all(folders, window, functools.partial(seed_scores, metric=metric))
    named = zip(runs, checked_labels(names, labels(runs)), strict=True)
    tasks = task_order(curves.env for curves in runs)
    runs = sorted((curves._replace(label=name) for curves, name in named), key=lambda run: tasks.index(run.env))
    return [_metric_row(curves, metric) if metric else row_of(curves) for curves in runs]


def _metric_row(curves: Curves, metric: str) -> Row:
    interval = interval_of(curves, seed_scores(curves, metric=metric), metric)
    return {
        "env": curves.env, "algo": curves.label, "options": options_text(curves.options), "seeds": curves.seeds,
        "steps": curves.length, "metric": metric, "mean_over": curves.window.text, **interval.columns("mean"),
    }  # fmt: skip


def windows_text(windows: Iterable[str]) -> str:
    """Return what scores are means over, in words: each of their `windows` once, as pooled runs can have others."""
    return " or ".join(dict.fromkeys(windows))


def run_table(rows: Sequence[Row]) -> Table:
    """Return the table of rows of `tabulate`, with notes of what their scores are means of, and of the options of each."""
    score = f"The score of a seed is its mean over {windows_text(row['mean_over'] for row in rows)}. {INTERVALS}"
    options = [f"{row['algo']}: {row['options']}" for row in rows]
    if "metric" in rows[0]:
        mean = (f"{rows[0]['metric']}, mean [95 %]", lambda row: interval_text(*Estimate.of_row(row, "mean"), ".4g"))
        return Table.of([*NAMES, ("seeds", lambda row: row["seeds"]), STEPS, mean], rows, [score, *options])
    life = [(name, cell) for name, cell in LIFE if any(cell(row) != "-" for row in rows)]
    crossed = [CROSSED] if any(row[f"steps_to_{LEVELS[0]}"] is not None for row in rows) else []
    return Table.of([*COLUMNS, *life], rows, [score, SHORT, *crossed, *([LEGEND] if life else []), *options])


def _interval(name: str) -> Column:
    return f"{name}, mean [95 %]", lambda row: interval_text(*Estimate.of_row(row, name))


def _crossing(level: float) -> Column:
    name = f"steps_to_{level}"
    return f"to {level} [95 %]", lambda row: step_interval(*Estimate.of_row(row, name))


def _number(heading: str, name: str, style: str) -> Column:
    return heading, lambda row: number_text(row[name], style)


NAMES: tuple[Column, ...] = (("task", lambda row: row["env"]), ("method", lambda row: row["algo"]))
STEPS = _number("steps", "steps", ",")
COLUMNS: tuple[Column, ...] = (
    *NAMES,
    ("seeds", lambda row: f"{row['seeds']}{diverged_text(row['diverged'], row['seeds'])}"),
    STEPS,
    _interval("deployed"),
    _number("seeds over 0.5", "seeds_above_half", ".0%"),
    ("published deployed", lambda row: row["published_deployed"] or "-"),
    ("continuing (stderr)", lambda row: error_text(row["continuing"], row["continuing_stderr"], ".5f")),
    ("published continuing", lambda row: row["published_continuing"] or "-"),
    *map(_crossing, LEVELS),
    _number("steps/reward", "steps_per_reward", ".1f"),
)
LIFE: tuple[Column, ...] = (
    _interval("wide"),
    _number("forward", "forward_success", ",.2f"),
    _number("back", "back_success", ",.2f"),
    _number("alive", "alive", ",.2f"),
    _number("still", "still_steps", ",.0f"),
)
"""Columns that are shown if a row has a value for them."""
SHORT = (
    f"stderr: {STDERR_RULE}. seeds over 0.5: the share of seeds with such a score. steps/reward: steps for a reward of 1 in the "
    "last quarter of the run, the median over seeds."
)
CROSSED = (
    f"to {LEVELS[0]}: the first step at which the mean success over {CROSSING_WINDOW:,} steps reaches it; its interval: the "
    "first steps at which the upper and the lower end of the interval of this mean reach it."
)
LEGEND = (
    "Means over seeds in the same window: wide, success from wide starts; forward and back, the share of phases that reached "
    "their goal; alive, 1 unless a direction has missed its goal for long; still, steps since the object moved."
)


def write(rows: Sequence[Row], path: Path, table: Callable[[Sequence[Row]], Table] = run_table) -> None:
    """Write rows to `path`: the `table` of them (.md, .tex), by default that of rows of `tabulate`, or any rows as csv (.csv).

    Raises:
        ValueError: `path` has another suffix.
    """
    require_suffix(path, TABLES, "tables")
    if path.suffix == ".csv":
        written(path, csv_text(rows))
    else:
        text = Table.text if path.suffix == ".md" else Table.latex
        written(path, f"{text(table(rows))}\n")


def csv_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return `rows` as csv with the columns of all of them; a cell is empty where its row has no such column."""
    text = io.StringIO()
    writer = csv.DictWriter(text, dict.fromkeys(name for row in rows for name in row), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def markdown_table(header: Sequence[str], lines: Sequence[Sequence[Any]]) -> str:
    """Return a markdown table."""
    rows = ["| " + " | ".join(str(cell).replace("|", r"\|") for cell in line) + " |" for line in (header, *lines)]
    return "\n".join([rows[0], "|" + " --- |" * len(header), *rows[1:]])


def _block(names: Sequence[str], row: Sequence[str], width: int) -> str:
    """Return a row as lines of name and cell, without empty cells."""
    indent = min(max(map(len, names)) + len(GAP), width // 2)
    lines = []
    for name, cell in zip(names, row, strict=True):
        if cell not in EMPTY:
            start = f"{name[: indent - 1]:<{indent}}"
            lines += textwrap.wrap(cell, width, initial_indent=start, subsequent_indent=" " * indent)
    return "\n".join(lines)


def wrapped(text: str, width: int | None) -> str:
    """Return the paragraphs of `text` in lines of at most `width` columns, or as they are without a width."""
    return text if width is None else "\n".join(textwrap.fill(line, width) for line in text.splitlines())


def terminal_width() -> int | None:
    """Return the number of columns of the terminal that stdout is, or None if it is none."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else None


def interval_text(value: float | None, low: float | None, high: float | None, style: str = ".3f") -> str:
    """Return `value [low, high]`, each as `number_text` in a format, without the interval if there is none."""
    text, *ends = (number_text(number, style) for number in (value, low, high))
    return text if ends[0] == "-" else f"{text} [{', '.join(ends)}]"


def error_text(mean: float | None, error: float | None, style: str) -> str:
    """Return a mean with its standard error in brackets, each as `number_text` in a format, without an error if there is none."""
    text, brackets = (number_text(number, style) for number in (mean, error))
    return text if brackets == "-" else f"{text} ({brackets})"


def number_text(value: float | None, style: str = ".3g", least: float = -math.inf) -> str:
    """Return a number in a format; `-` for None and nan.

    In a format of significant digits, thousands have no fraction and no exponent. A number below `least` is `<` and that.
    """
    if value is None or math.isnan(value):
        return "-"
    if style.endswith("g") and abs(value) >= 999.5:
        style = ",.0f"
    return f"<{least:g}" if value < least else format(value, style)


def millions(step: float | None) -> str:
    """Return a number of steps in millions, such as `2.50M`, below 0.1M as `steps_text`, and `-` for None and nan."""
    if step is None or math.isnan(step):
        return "-"
    return f"{step / 1e6:.2f}M" if step >= 1e5 else steps_text(step)


def steps_text(steps: float) -> str:
    """Return a number of steps in short with three digits, such as 500, 20k, 2.5M or 1.2B."""
    rounded = float(f"{steps:.3g}")
    unit, letter = next(((unit, letter) for unit, letter in UNITS if rounded >= unit), (1, ""))
    return f"{rounded / unit:g}{letter}"


def step_interval(value: float | None, low: float | None, high: float | None) -> str:
    """Return a crossing in millions of steps, with its interval if it has one; `-` stands for what was not reached."""
    text, *ends = map(millions, (value, low, high))
    return text if ends == ["-", "-"] else f"{text} [{', '.join(ends)}]"
