"""A self-contained HTML page of a comparison: the table of each task, with its differences as intervals on one scale."""

import math
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from earl_jax.errors import InputError
from earl_jax.report.comparison import HEADER, RULE, Row, cells
from earl_jax.report.html.writing import TEMPLATES, raw, template_environment, write_ascii

WIDTH, MARGIN = 180, 6
"""Of a drawn interval, in pixels."""


def write_comparison_page(rows: Sequence[Row], folders: Sequence[Path], against: str, out: Path) -> Path:
    """Write the rows of `compare` of `folders` to `out`, an .html file, and return the path.

    Raises:
        ValueError: `out` is not an .html file, or jinja2 is not installed.
    """
    if out.suffix != ".html" or out.is_dir():
        raise InputError(f"{out}: a page is written as an .html file")
    envs = list(dict.fromkeys(row["env"] for row in rows))
    more = ["--against", against] if against != "runs" else []
    page = (
        template_environment()
        .get_template("comparison.html")
        .render(
            title=f"{'Runs and the published scores' if more else 'Runs compared'}: {', '.join(envs)}",
            tasks=[_task([row for row in rows if row["env"] == env]) for env in envs],
            header=HEADER[1:],
            width=WIDTH,
            rule=RULE,
            style=raw((TEMPLATES / "report.css").read_text()),
            command=shlex.join(["earl-jax", "compare", *map(str, folders), *more, "--out", str(out)]),
        )
    )
    return write_ascii(page, out)


def _task(rows: Sequence[Row]) -> dict[str, Any]:
    """Return the rows of one task as texts and positions, on a scale that has all intervals and 0."""
    ends = [row[key] for row in rows for key in ("low", "difference", "high") if not math.isnan(row[key])]
    low, high = min([0.0, *ends]), max([0.0, *ends])

    def x(value: float) -> float:
        return round(MARGIN + (WIDTH - 2 * MARGIN) * (value - low) / ((high - low) or 1.0), 1)

    drawn = [
        {
            "texts": line[1:],
            "plot": None if math.isnan(row["low"]) else [x(row[key]) for key in ("low", "difference", "high")],
            "is_clear": row["verdict"] in ("above", "below"),
        }
        for row, line in zip(rows, cells(rows), strict=True)
    ]
    return {"env": rows[0]["env"], "rows": drawn, "low": f"{low:.3g}", "high": f"{high:.3g}", "zero": x(0.0)}
