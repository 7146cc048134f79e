"""The leaderboard of a page: the runs of the page among the rows that ship with the package."""

from collections.abc import Sequence
from typing import Any

from earl_jax.report.html.lines import Line
from earl_jax.report.html.origin import UNKNOWN, provenance
from earl_jax.report.leaderboard import HEADER, OURS, Row, ranked, run_row, shipped_rows
from earl_jax.report.runs import label
from earl_jax.report.style import task_order, task_title

HERE = "this page"
"""Where a row of the page's own runs comes from."""
SEVERAL = "several"


def leaderboard(lines: Sequence[Line]) -> dict[str, Any]:
    """Return the leaderboards of the tasks of `lines`, a row for each method; `left_out` are lines that it does not take.

    It takes the paper's tasks, with their own options and in the deployment setting. A row of ours that ships and has the
    method, the numbers and the commit of a line of the page is that run, and is shown once.
    """
    shipped = shipped_rows()
    known = {row.env for row in shipped}
    fitting = [line for line in lines if line.group.env in known and line.curves.comparable]
    own = {_row(line): line for line in fitting}
    ours = {_identity(row) for row in own}
    rows = ranked([*own, *(row for row in shipped if row.source != OURS or _identity(row) not in ours)])
    groups = [
        {
            "title": task_title(env),
            "env": env,
            "rows": [{"line": own.get(row), "name": _name(row), "texts": row.texts[1:]} for row in rows[env]],
        }
        for env in task_order(line.group.env for line in lines)
        if env in known
    ]
    left_out = [line for line in lines if line not in fitting and line.group.env in known]
    return {"head": HEADER[1:], "groups": groups, "left_out": left_out}


def _row(line: Line) -> Row:
    """Return the row of a line, under the name of its method with all of its changed options."""
    group = line.group
    commits = {provenance(run)["commit"].replace(UNKNOWN, "") for run in line.runs}
    named = group._replace(label=label(group.algo, line.curves.options, [{}]))
    return run_row(named, commits.pop() if len(commits) == 1 else SEVERAL, HERE)


def _name(row: Row) -> tuple[str, str]:
    """Return method and options of a row."""
    method, _, options = row.method.partition(" (")
    return method, options.removesuffix(")")


def _identity(row: Row) -> tuple[object, ...]:
    """Return what tells the runs of two rows apart: a name can have more or fewer of the options."""
    return (row.env, _name(row)[0], *row[Row._fields.index("seeds") : Row._fields.index("score")])
