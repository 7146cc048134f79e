"""What benchmarks write: results with the command and the versions that made them, and tables in pages."""

import csv
import json
import shlex
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from earl_jax.report.tables import csv_text
from earl_jax.runs.provenance import provenance

RESULTS = Path(__file__).parent / "results"
ROOT = RESULTS.parents[1]
DOCS = ROOT / "docs"
MARKS = "<!-- {} -->", "<!-- end of {} -->"
"""The comments before and after a table in a page."""


def emit(report: dict[str, Any], path: Path | None) -> None:
    """Print `report` as one JSON line, and save it to `path` unless that is None."""
    print(json.dumps(report))
    if path:
        save(path, report)


def save(path: Path, report: dict[str, Any]) -> None:
    """Write `report` to `path` with versions, platform, commit and the command of this process."""
    module = getattr(sys.modules["__main__"], "__spec__", None)
    arguments = [Path(word).name if Path(word).is_absolute() else word for word in sys.argv[1:]]
    command = shlex.join(["python", "-m", module.name if module else "", *arguments])
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({"command": command, **report, "provenance": provenance()}, indent=1) + "\n")


def save_rows(path: Path, rows: Sequence[Mapping[str, Any]], **about: Any) -> None:
    """Write `rows` to `path`.csv and, with `about` as by `save`, to `path`.json."""
    save(path.with_suffix(".json"), {**about, "rows": rows})
    path.with_suffix(".csv").write_text(csv_text(rows))


def shrink(picture: Path) -> None:
    """Reduce a picture to 256 colours, which halves the size of a figure of many thin lines."""
    from PIL import Image

    Image.open(picture).convert("RGB").quantize(256).save(picture, optimize=True)


def read_csv(path: Path) -> list[dict[str, str]]:
    """Return the rows of a csv file."""
    with path.open(newline="") as handle:
        return list(csv.DictReader(handle))


def pages_with(tables: Mapping[str, str]) -> dict[Path, str]:
    """Return the pages that have the marks of one of `tables`, as texts with the tables between their marks.

    Raises:
        ValueError: no page has the marks of a table, or one has the first mark of a table alone.
    """
    pages = [ROOT / "README.md", *sorted(DOCS.rglob("*.md")), *sorted(ROOT.glob("examples/*/README.md"))]
    texts, missing = {}, set(tables)
    for path in pages:
        text = path.read_text()
        names = [name for name in tables if MARKS[0].format(name) in text]
        if names:
            texts[path] = with_tables(text, {name: tables[name] for name in names})
            missing -= set(names)
    if missing:
        raise ValueError(
            f"no page has the marks of {', '.join(sorted(missing))}, such as {MARKS[0].format(min(missing))}"
        )
    return texts


def with_tables(page: str, tables: Mapping[str, str]) -> str:
    """Return the text of `page` with each table between the comments `NAME` and `end of NAME` that mark its place."""
    for name, table in tables.items():
        start, end = (mark.format(name) for mark in MARKS)
        before, first, rest = page.partition(start)
        _, last, after = rest.partition(end)
        if not (first and last):
            raise ValueError(f"the page lacks {start} or {end}")
        page = f"{before}{start}\n\n{table}\n\n{end}{after}"
    return page


def write_files(files: Mapping[Path, str]) -> None:
    """Write texts to their paths."""
    for path, text in files.items():
        path.write_text(text)
