"""The results of the catalogue as csv, markdown and json."""

import csv
import os
import platform
import textwrap
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.attacks.runner import Row
from benchmarks.output import save

FIELDS = ["class", "case", "expected", "verdict", "how", "seconds", "peak_mb"]
HOWS = 4
"""Ways of survival that the table names for a class, the most frequent ones."""


def summary(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Return a row for each class: tried, survived, how, seconds, peak_mb; the last one is the total."""
    classes = {
        kind: [row for row in rows if row["class"] == kind] for kind in dict.fromkeys(row["class"] for row in rows)
    }
    return [_summed(kind, group) for kind, group in classes.items()] + [_summed("all", list(rows))]


def _summed(kind: str, rows: list[Row]) -> dict[str, Any]:
    survived = [row for row in rows if row["verdict"] == "survived"]
    hows = Counter(row["how"] for row in survived).most_common()
    named = [f"{count} {how}" for how, count in hows[:HOWS]]
    rest = sum(count for _, count in hows[HOWS:])
    return {
        "class": kind,
        "tried": len(rows),
        "survived": len(survived),
        "how": "; ".join([*named, *([f"{rest} otherwise"] if rest else [])]),
        "seconds": round(sum(row["seconds"] for row in rows)),
        "peak_mb": round(max((row["peak_mb"] for row in rows), default=0)),
    }


def markdown(rows: Sequence[Row], command: str) -> str:
    """Return the table of the classes, and the failed cases."""
    lines = [
        "# Attacks survived", "", _wrapped(f"`{command}`, {_machine()}."), "",
        "| class | tried | survived | how | s | peak MB |", "| --- | --- | --- | --- | --- | --- |",
        *("| {class} | {tried} | {survived} | {how} | {seconds} | {peak_mb} |".format(**row) for row in summary(rows)),
    ]  # fmt: skip
    failed = [row for row in rows if row["verdict"] == "failed"]
    if failed:
        lines += ["", "Failed:", ""]
        lines += [
            _wrapped(f"- {row['class']}: {row['case']}. Expected: {row['expected']}. {row['how'][:300]}")
            for row in failed
        ]
    return "\n".join(lines) + "\n"


def _wrapped(text: str) -> str:
    """Return a paragraph or an item of a list in lines of less than 100 columns."""
    indent = "  " if text.startswith("- ") else ""
    return textwrap.fill(text, 99, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


def _machine() -> str:
    return f"{len(os.sched_getaffinity(0))} CPU cores ({platform.machine()}), Python {platform.python_version()}"


def write(folder: Path, rows: Sequence[Row], command: str) -> None:
    """Write attacks.csv (a row for each case), attacks.md (the classes) and attacks.json (both, with versions)."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "attacks.csv").open("w", newline="") as handle:
        writer = csv.DictWriter(handle, FIELDS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    (folder / "attacks.md").write_text(markdown(rows, command))
    save(folder / "attacks.json", command, {"machine": _machine(), "classes": summary(rows)})
