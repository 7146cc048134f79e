"""Tables as text: markdown for files and pipes, and for a terminal a table that fits its width."""

import shutil
import sys
import textwrap
from collections.abc import Sequence
from typing import Any

from earl_jax.report.tables import markdown_table

GAP = "  "
EMPTY = {"", "-"}


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
