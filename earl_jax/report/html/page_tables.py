"""The tables of one task as text: the paper's tables 1 and 2, the leaderboard, tests of differences, final scores of seeds."""

import itertools
import math
from collections.abc import Sequence
from typing import Any

from earl_jax.metrics.continuing import diverged_text
from earl_jax.report.comparison import COLUMNS, pair_row, verdict_text, with_verdicts
from earl_jax.report.html.curves import PANELS, Line
from earl_jax.report.leaderboard import COLUMNS as BOARD, OURS, ranked, run_row, shipped_rows, texts
from earl_jax.report.paper_rows import DESCRIPTIONS, HEADINGS, paper_rows, share_of_steps
from earl_jax.report.published import PublishedScore, published_fault
from earl_jax.report.runs import label
from earl_jax.report.scores import seed_scores
from earl_jax.report.tables import Row, error_text, number_text, steps_text
from earl_jax.runs.folder import RunFolder
from earl_jax.runs.provenance import made_by

MACHINE = ("python", "backend", "device", "commit")
"""Names in the provenance besides versions of packages."""
UNKNOWN = "unknown"
HERE = "this page"
"""Where a row of the page's own runs comes from."""
TableRow = tuple[Line | None, str, Sequence[str]]
"""A row of a table: its line if it is one of the page's, the method with options in brackets, and cells as text."""
ARROWS = {"above": "▲ ", "below": "▼ "}
HEAD = ("seeds × steps", "mean (s.e.)", "95 % of the mean", "published", "verdict")
"""The columns of the paper's tables."""


def paper_table(number: int, lines: Sequence[Line]) -> dict[str, Any]:
    """Return table `number` of the paper for one task's `lines`, with methods not run and known faults of the published."""
    env, known = lines[0].curves.env, {line.curves.label: line for line in lines}
    rows = [row for row in paper_rows(number, [line.curves for line in lines]) if row["env"] == env]
    lead, _, text = HEADINGS[number].partition(": ")
    fault = published_fault(number, env)
    note = DESCRIPTIONS[number] + (f" A known fault of the published scores: {fault}" if fault else "")
    table_rows = [_paper_row(row, known.get(row["label"])) for row in rows]
    return {"lead": lead, "text": text, "note": note, "head": HEAD, "rows": table_rows}


def _paper_row(row: Row, line: Line | None) -> TableRow:
    published = _typeset(PublishedScore(row["published_mean"], row["published_stderr"]).text)
    if line is None:
        return None, row["label"], ["not run", "", "", published, _verdict(row)]
    style = {"deployed/success": ",.3f", "deployed/return": ",.1f"}.get(row["metric"], ",.4f")
    mean = _typeset(error_text(row["mean"], row["stderr"], style))
    low, high = (_typeset(number_text(row[end], style)) for end in ("low", "high"))
    size = f"{row['seeds']} × {steps_text(row['steps'])}{diverged_text(row['diverged'], row['seeds'])}"
    interval = "–" if low == "–" else f"[{low}, {high}]"
    return line, row["label"], [size, mean, interval, published, _verdict(row)]


def _verdict(row: Row) -> str:
    share = share_of_steps(row)
    if row["p_holm"] is None or math.isnan(row["p_holm"]):
        return share
    verdict = f"{ARROWS.get(row['verdict'], '')}{verdict_text(row)}, p = {row['p_holm']:.2g}"
    return f"{verdict}, {share}" if share else verdict


def leaderboard(lines: Sequence[Line]) -> dict[str, Any]:
    """Return the leaderboard of one task's `lines`, a row for each method; `left_out` are lines that it does not take.

    It takes the paper's tasks, with their own options and in the deployment setting. A row of ours that ships and has the
    method, the numbers and the commit of a line of the page is that run, and is shown once.
    """
    env = lines[0].curves.env
    shipped = [row for row in shipped_rows() if row["env"] == env]
    own = [_board_row(line) for line in lines if line.curves.comparable]
    shown = [_identity(row) for row in own]
    rows = ranked([*own, *(row for row in shipped if row["source"] != OURS or _identity(row) not in shown)])
    table_rows = [(row.get("line"), row["method"], texts(row)[1:]) for row in rows.get(env, ())]
    left_out = [line.curves.label for line in lines if not line.curves.comparable]
    return {"head": list(BOARD.values())[1:], "rows": table_rows, "left_out": left_out, "marked": len(own)}


def _board_row(line: Line) -> Row:
    """Return the row of a line, under the name of its method with all of its changed options."""
    curves = line.curves
    return run_row(curves._replace(label=label(curves.algo, curves.options)), HERE) | {"line": line}


def _identity(row: Row) -> list[Any]:
    """Return what tells the runs of two rows apart: a name can have more or fewer of the options."""
    return [row["method"].partition(" (")[0], *(row[name] for name in BOARD if name not in ("method", "source"))]


def difference_table(lines: Sequence[Line]) -> dict[str, Any]:
    """Return the tests of differences between deployed scores of one task's `lines`, a row for each pair with a common step."""
    pairs = itertools.combinations(lines, 2)
    tested = [(first, row) for first, second in pairs if (row := pair_row(first.curves, second.curves))]
    with_verdicts([row for _, row in tested])
    columns = COLUMNS[2:]  # without the task, and the first method has a cell of its own
    rows = [(line, line.curves.label, [cell(row) for _, cell in columns]) for line, row in tested]
    return {"head": [name for name, _ in columns], "rows": rows}


def seed_table(lines: Sequence[Line]) -> dict[str, Any]:
    """Return for every seed of one task's `lines` a row of its score and the last values of `PANELS`."""
    panels = [panel for panel in PANELS if panel.metric and any(panel.metric in line.curves.metrics for line in lines)]
    rows = []
    for line in lines:
        metrics, scores = line.curves.metrics, seed_scores(line.curves)
        for lane, seed in enumerate(line.seeds):
            last = [metrics[panel.metric][lane, -1] if panel.metric in metrics else math.nan for panel in panels]
            texts = [_typeset(number_text(value, ".4g")) for value in (scores[lane], *last)]
            rows.append((line, line.curves.label, [str(seed), *texts]))
    name = lines[0].curves.deployed_metric.removeprefix("deployed/")
    head = ["seed", f"score ({name})", *(panel.title for panel in panels)]
    return {"head": head, "rows": rows}


def _typeset(number: str) -> str:
    """Return the text of a number with the signs of print: `−` for minus, and `–` where `-` stands for nothing."""
    return "–" if number == "-" else number.replace("-", "−")


def provenance(run: RunFolder) -> dict[str, str]:
    """Return the machine and the version of each package from a run's config, as texts; `unknown` for what it lacks."""
    known = run.recorded().get("provenance")
    known = known if isinstance(known, dict) else {}
    versions = known.get("versions")
    values = {name: known.get(name) for name in MACHINE} | {"commit": made_by(known) or None}
    values |= versions if isinstance(versions, dict) else {}
    return {str(name): UNKNOWN if value is None else str(value) for name, value in values.items()}
