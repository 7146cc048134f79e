"""Tables: the rows of run folders, and any rows as markdown, LaTeX, csv or text for a terminal, with their numbers as text."""

import csv
import html
import math
import re
import shutil
import sys
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from earl_jax.errors import InputError
from earl_jax.metrics.comparison import mean_interval
from earl_jax.metrics.continuing import diverged_text
from earl_jax.metrics.statistics import Estimate
from earl_jax.report.published import LEVELS
from earl_jax.report.runs import Curves, labels, options_text, read_all
from earl_jax.report.scores import MEANS, last_mean, row_of

GAP = "  "
EMPTY = {"", "-"}
HEADER = (
    "env", "algo", "seeds", "steps", "deployed, mean [95 %]", "seeds over 0.5", "published", "continuing", "published",
    "to 0.5 [95 %]", "to 0.9 [95 %]", "steps/reward",
)  # fmt: skip
WIDE_HEADING = "wide, mean [95 %]"


def tabulate(folders: Sequence[Path], last: int = 1, metric: str | None = None) -> list[dict[str, Any]]:
    """Return one row per method: deployed and continuing scores over seeds, crossings, and the published scores.

    Args:
        folders: run folders; seeds of the same task, method and options are pooled.
        last: evaluations averaged at the end of a run; the paper's table 1 uses 1.
        metric: a column of metrics.csv, of which alone a row then has the mean and its interval.

    Raises:
        ValueError: `last` is below 1, a folder cannot be read, or a run has no column `metric`.
    """
    if last < 1:
        raise InputError(f"last must be at least 1, not {last}")
    runs = read_all(folders)
    named = zip(runs, labels(runs), strict=True)
    return [_metric_row(curves, metric, last, name) if metric else row_of(curves, last, name) for curves, name in named]


def _metric_row(curves: Curves, metric: str, last: int, name: str) -> dict[str, Any]:
    interval = mean_interval(last_mean(curves.metrics[metric], last))
    return {
        "env": curves.config.env, "algo": name, "options": options_text(curves.options), "seeds": curves.seeds,
        "steps": int(curves.steps[-1]), "metric": metric, "mean": interval.value, "low": interval.low, "high": interval.high,
    }  # fmt: skip


def markdown_table(header: Sequence[str], lines: Sequence[Sequence[Any]]) -> str:
    """Return a markdown table."""
    rows = ["| " + " | ".join(map(str, line)) + " |" for line in (header, *lines)]
    return "\n".join([rows[0], "|" + " --- |" * len(header), *rows[1:]])


def latex_table(header: Sequence[str], lines: Sequence[Sequence[Any]]) -> str:
    """Return a LaTeX `tabular` for the package booktabs."""
    rows = [" & ".join(map(_latex_text, line)) + r" \\" for line in (header, *lines)]
    rows = [r"\begin{tabular}{" + "l" * len(header) + "}", r"\toprule", rows[0], r"\midrule", *rows[1:]]
    return "\n".join([*rows, r"\bottomrule", r"\end{tabular}"])


def html_table(header: Sequence[str], lines: Sequence[Sequence[Any]]) -> str:
    """Return an HTML table, all texts escaped."""
    rows = [
        "".join(f"<{tag}>{html.escape(str(cell))}</{tag}>" for cell in line)
        for tag, line in (("th", header), *(("td", line) for line in lines))
    ]
    return "<table>" + "\n".join(f"<tr>{row}</tr>" for row in rows) + "</table>"


def _latex_text(value: Any) -> str:
    return re.sub(r"([%&_#$])", r"\\\1", str(value)).replace("−", "$-$")


def file_table(path: Path, header: Sequence[str], lines: Sequence[Sequence[Any]], notes: str) -> str:
    """Return the text of the file `path`: a LaTeX table with `notes` as comments (.tex), or a markdown one above them."""
    if path.suffix == ".tex":
        lines_of_notes = [line for note in notes.splitlines() for line in textwrap.wrap(note, 100)]
        comments = "\n".join(f"% {line}" for line in lines_of_notes)
        return f"{comments}\n{latex_table(header, lines)}\n"
    return f"{markdown_table(header, lines)}\n\n{notes}\n"


def markdown(rows: list[dict[str, Any]]) -> str:
    """Return `rows` as a markdown table: means with intervals, published scores beside them."""
    return "\n".join([markdown_table(header_of(rows), lines_of(rows)), "", *notes_of(rows)])


def header_of(rows: list[dict[str, Any]]) -> Sequence[str]:
    """Return the header of rows of `tabulate`."""
    if "metric" in rows[0]:
        return ("env", "algo", "seeds", "steps", f"{rows[0]['metric']}, mean [95 %]")
    return (*HEADER, *_life_headings(rows))


def lines_of(rows: list[dict[str, Any]]) -> list[list[Any]]:
    """Return the cells of rows of `tabulate`, as text."""
    if "metric" not in rows[0]:
        return _lines(rows)
    means = [interval_text(row["mean"], row["low"], row["high"], ".4g") for row in rows]
    return [
        [row["env"], row["algo"], row["seeds"], f"{row['steps']:,}", mean]
        for row, mean in zip(rows, means, strict=True)
    ]


def _lines(rows: list[dict[str, Any]]) -> list[list[Any]]:
    headings = _life_headings(rows)
    return [
        [
            row["env"], row["algo"], f"{row['seeds']}{diverged_text(row['diverged'], row['seeds'])}", f"{row['steps']:,}",
            interval_text(row["deployed"], row["deployed_low"], row["deployed_high"]),
            "-" if row["seeds_above_half"] is None else f"{row['seeds_above_half']:.0%}",
            row["published_deployed"] or "-", f"{row['continuing']:.5f} ({row['continuing_stderr']:.5f})",
            row["published_continuing"] or "-", *(_reached(row, level) for level in LEVELS),
            "-" if row["steps_per_reward"] is None else f"{row['steps_per_reward']:.1f}",
            *_life_texts(row, headings),
        ]
        for row in rows
    ]  # fmt: skip


def _life_headings(rows: list[dict[str, Any]]) -> list[str]:
    """Return the headings of those columns that a row has a value for."""
    headings = [WIDE_HEADING] if any(row["wide"] is not None for row in rows) else []
    return headings + [heading for name, (_, heading, _) in MEANS.items() if any(row[name] is not None for row in rows)]


def _life_texts(row: dict[str, Any], headings: list[str]) -> list[str]:
    """Return the texts of `row` under `headings`."""
    texts = {WIDE_HEADING: "-"}
    if row["wide"] is not None:
        texts[WIDE_HEADING] = interval_text(row["wide"], row["wide_low"], row["wide_high"])
    for name, (_, heading, digits) in MEANS.items():
        texts[heading] = "-" if row[name] is None else f"{row[name]:,.{digits}f}"
    return [texts[heading] for heading in headings]


def notes_of(rows: list[dict[str, Any]]) -> list[str]:
    """Return a line for each of `rows` with the options of its runs."""
    return [f"{row['algo']}: {row['options']}" for row in rows]


def _reached(row: dict[str, Any], level: float) -> str:
    names = (f"steps_to_{level}", f"steps_to_{level}_low", f"steps_to_{level}_high")
    return step_interval(Estimate(*(math.nan if row[name] is None else row[name] for name in names)))


def interval_text(value: float, low: float, high: float, style: str = ".3f") -> str:
    """Return `value [low, high]` in a format, without the interval if it is nan; `-` without a value."""
    if math.isnan(low):
        return "-" if math.isnan(value) else format(value, style)
    return f"{value:{style}} [{low:{style}}, {high:{style}}]"


def number_text(value: float) -> str:
    """Return a number with three digits, `-` for nan."""
    return "-" if math.isnan(value) else f"{value:.3g}"


def seeds_text(count: int) -> str:
    """Return a number of seeds in words, such as `1 seed` or `5 seeds`."""
    return f"{count} seed{'s' * (count != 1)}"


def millions(step: float | None) -> str:
    """Return a number of steps in millions, such as `2.50M`, and `-` for None and nan."""
    return "-" if step is None or math.isnan(step) else f"{step / 1e6:.2f}M"


def steps_text(steps: float | None) -> str:
    """Return a number of steps in short, such as 500, 20k or 2.5M; `–` for None and nan."""
    if steps is None or math.isnan(steps):
        return "–"
    return f"{steps / 1e6:.3g}M" if steps >= 1e6 else f"{steps / 1e3:.3g}k" if steps >= 1e3 else f"{steps:g}"


def step_interval(estimate: Estimate) -> str:
    """Return a crossing with its interval in millions of steps; `-` stands for an end that was not reached."""
    if all(map(math.isnan, estimate)):
        return "-"
    return f"{millions(estimate.value)} [{millions(estimate.low)}, {millions(estimate.high)}]"


def write(rows: list[dict[str, Any]], path: Path) -> None:
    """Write rows to `path`: rows of `tabulate` as markdown (.md) or LaTeX (.tex), or any rows as csv (.csv).

    Raises:
        ValueError: `path` has another suffix.
    """
    if path.suffix in (".md", ".tex"):
        path.write_text(file_table(path, header_of(rows), lines_of(rows), "\n".join(notes_of(rows))))
    elif path.suffix == ".csv":
        with path.open("w", newline="") as handle:
            writer = csv.DictWriter(handle, rows[0], lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
    else:
        raise InputError(f"{path}: tables are written as .md, .tex or .csv")


def terminal_width() -> int | None:
    """Return the number of columns of the terminal that stdout is, or None if it is none."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else None


def shown_table(header: Sequence[str], lines: Sequence[Sequence[Any]], width: int | None) -> str:
    """Return a table for a terminal of `width` columns, or a markdown table without a width.

    Where the columns are too wide together, each row is a block with a line for each of its cells.
    """
    if width is None:
        return markdown_table(header, lines)
    rows = [[str(cell) for cell in line] for line in lines]
    kept = [i for i in range(len(header)) if i == 0 or any(row[i] not in EMPTY for row in rows)]
    names, rows = [header[i] for i in kept], [[row[i] for i in kept] for row in rows]
    sizes = [max(map(len, column)) for column in zip(names, *rows, strict=True)]
    if sum(sizes) + len(GAP) * (len(sizes) - 1) > width:
        return "\n\n".join(_block(names, row, width) for row in rows)
    return "\n".join(GAP.join(map(str.ljust, line, sizes)).rstrip() for line in (names, *rows))


def wrapped(text: str, width: int | None) -> str:
    """Return the paragraphs of `text` in lines of at most `width` columns, or as they are without a width."""
    return text if width is None else "\n".join(textwrap.fill(line, width) for line in text.splitlines())


def _block(names: Sequence[str], row: Sequence[str], width: int) -> str:
    """Return a row as lines of name and cell, without empty cells."""
    indent = min(max(map(len, names)) + len(GAP), width // 2)
    lines = []
    for name, cell in zip(names, row, strict=True):
        if cell not in EMPTY:
            start = f"{name[: indent - 1]:<{indent}}"
            lines += textwrap.wrap(cell, width, initial_indent=start, subsequent_indent=" " * indent)
    return "\n".join(lines)
