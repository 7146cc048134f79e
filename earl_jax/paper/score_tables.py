"""Tables 1 and 2 of the paper made from run folders, beside the published scores.

Source: Sharma et al. 2022, tables 1 and 2.
"""

import textwrap
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from earl_jax.errors import InputError
from earl_jax.metrics.continuing import diverged_text
from earl_jax.metrics.statistics import Estimate
from earl_jax.paper.claims import table2_claims
from earl_jax.report.paper_rows import DESCRIPTIONS, HEADINGS, paper_rows, share_of_steps
from earl_jax.report.published import INTERVAL_RULE, PublishedScore, estimate_text, published_fault
from earl_jax.report.runs import read_methods
from earl_jax.report.style import colours, legend_below, method_order, new_figure, reach, save, task_title
from earl_jax.report.tables import markdown_table, seeds_text, write

Row = dict[str, Any]
DIGITS = {"deployed/success": 3, "deployed/return": 2}
AXES = {"deployed/success": "success", "deployed/return": "return"}


def write_table(number: int, folders: Sequence[Path], out: Path) -> list[Path]:
    """Write table `number` of the paper (1 or 2) from run folders into `out` and return the files: csv, md, png.

    Raises:
        ValueError: the table is unknown, a folder is no run or has no evaluation, or matplotlib is not installed.
    """
    if number not in HEADINGS:
        raise InputError(f"there is no table {number}; choose from {', '.join(map(str, HEADINGS))}")
    groups = read_methods(folders)
    rows = paper_rows(number, groups)
    figure = _draw(number, rows)
    out.mkdir(parents=True, exist_ok=True)
    csv_file, text_file, picture = (out / f"table{number}{suffix}" for suffix in (".csv", ".md", ".png"))
    write(rows, csv_file)
    claims = [table2_claims(groups)] if number == 2 else []
    text_file.write_text(_markdown(number, rows, claims))
    return [csv_file, text_file, save(figure, picture)]


def _markdown(number: int, rows: Sequence[Row], claims: Sequence[str]) -> str:
    parts = [
        f"# {HEADINGS[number]}",
        DESCRIPTIONS[number],
        "Each cell: ours, mean (standard error) / published, mean (standard error) / verdict. A run that is shorter than the "
        "published ones is not compared; its share of the steps stands there.",
        _table_by_task(rows, _comparison),
        *claims,
    ]
    if number == 1:
        parts.append(
            "Less noisy, the mean over the evaluations of the last 100,000 steps: ours, mean (standard error) / of the "
            "released curves."
        )
        parts.append(_table_by_task(rows, _recent_comparison))
    parts += [_tests(rows), INTERVAL_RULE]
    trained = [row for row in rows if row["seeds"] is not None]
    faults = {env: published_fault(f"table{number}", env) for env in dict.fromkeys(row["env"] for row in trained)}
    fault_lines = [f"- {env}: {fault}" for env, fault in faults.items() if fault]
    if fault_lines:
        parts.append("\n".join(["Known faults of published scores:", "", *fault_lines]))
    heading = "Runs:"
    parts.append("\n".join([heading, "", *map(_run_note, trained)]))
    return "\n\n".join([*parts, _missing(rows)]) + "\n"


def _table_by_task(rows: Sequence[Row], text: Callable[[Row], str]) -> str:
    """Return a markdown table of `text(row)`, a line per method and a column per task."""
    envs = list(dict.fromkeys(row["env"] for row in rows))
    texts = {(row["label"], row["env"]): text(row) for row in rows}
    algos = method_order(row["algo"] for row in rows)
    names = dict.fromkeys(row["label"] for algo in algos for row in rows if row["algo"] == algo)
    lines = [[name, *(texts.get((name, env), "-") for env in envs)] for name in names]
    return markdown_table(["method", *envs], lines)


def _comparison(row: Row) -> str:
    ours = _ours(row, "mean", "stderr")
    if row["published_mean"] == "-":
        return f"{ours} / - / -"
    share = share_of_steps(row)
    verdict = f"at {share} of the steps" if share else row["verdict"]
    return f"{ours} / {PublishedScore(row['published_mean'], row['published_stderr']).text} / {verdict}"


def _recent_comparison(row: Row) -> str:
    return f"{_ours(row, 'recent', 'recent_stderr')} / {row['published_last10'] or '-'}"


def _tests(rows: Sequence[Row]) -> str:
    """Return a table of the tests against the published scores, or a line that there is none."""
    tested = [row for row in rows if row["p"] is not None]
    if not tested:
        return "No run has the published length, so none is tested against the published scores."
    header = ["env", "method", "ours minus published [95 %]", "p", "adjusted p", "verdict", "detectable"]
    lines = []
    for row in tested:
        difference = Estimate(row["difference"], row["difference_low"], row["difference_high"])
        numbers = [f"{row['p']:.2g}", "-" if row["p_holm"] is None else f"{row['p_holm']:.2g}"]
        text = estimate_text(difference, DIGITS.get(row["metric"], 4))
        lines.append([row["env"], row["label"], text, *numbers, row["verdict"], f"{row['detectable']:.2g}"])
    return markdown_table(header, lines)


def _ours(row: Row, mean: str, error: str) -> str:
    if row["mean"] is None:
        return "-"
    digits = DIGITS.get(row["metric"], 4)
    return f"{row[mean]:.{digits}f} ({row[error]:.{digits}f})"


def _missing(rows: Sequence[Row]) -> str:
    missing: dict[str, list[str]] = {}
    for row in rows:
        if row["seeds"] is None:
            missing.setdefault(row["env"], []).append(row["algo"])
    texts = [f"{env} ({', '.join(algos)})" for env, algos in missing.items()]
    return f"Not run, shown as `-`: {', '.join(texts)}." if texts else "Every method of the published table was run."


def _run_note(row: Row) -> str:
    low, high = row["published_steps_low"], row["published_steps_high"]
    published = "-" if low is None else f"{low:,}" if low == high else f"{low:,} to {high:,}"
    shorter = ", shorter than published" if low and row["steps"] < low else ""
    seeds = f"{seeds_text(row['seeds'])}{diverged_text(row['diverged'], row['seeds'])}"
    steps = f"{row['steps']:,} steps (published {published})"
    return f"- {row['env']}, {row['label']}: {steps}, {seeds}, {row['options']}{shorter}"


def _draw(number: int, rows: Sequence[Row]) -> Any:
    """Return a figure with a panel for each task that was run: our means with intervals beside the published ones."""
    envs = list(dict.fromkeys(row["env"] for row in rows if row["seeds"] is not None))
    columns = 2 if len(envs) == 4 else min(3, len(envs))
    lines = -(-len(envs) // columns)
    figure, axes = new_figure(lines, columns, (max(4.6 * columns, 7.0), 3.3 * lines + 0.9))
    for axis in axes.flat[len(envs) :]:
        axis.set_axis_off()
    palette = colours(row["algo"] for row in rows)
    for env, axis in zip(envs, axes.flat, strict=False):
        _draw_task(axis, [row for row in rows if row["env"] == env], palette)
    figure.suptitle(HEADINGS[number])
    _add_legend(figure)
    return figure


def _draw_task(axis: Any, rows: Sequence[Row], palette: dict[str, str]) -> None:
    axis.use_sticky_edges = False
    for position, row in enumerate(rows):
        _draw_row(axis, position, row, palette[row["algo"]])
    names = [textwrap.shorten(row["label"], 40, placeholder=" …") for row in rows]
    slanted = {"rotation": 20, "ha": "right"} if any(row["label"] != row["algo"] for row in rows) else {}
    axis.set_xticks(range(len(rows)), names, fontsize="small", **slanted)
    axis.set(title=task_title(rows[0]["env"]), xlim=(-0.6, len(rows) - 0.4))
    metric = next(row["metric"] for row in rows if row["metric"])
    axis.set_ylabel(AXES.get(metric, "reward per step"))
    axis.grid(axis="y", alpha=0.3)


def _draw_row(axis: Any, position: int, row: Row, colour: str) -> None:
    if row["published_low"] is not None:
        low, high = row["published_low"], row["published_high"]
        axis.bar(position, high - low, 0.7, low, color="0.6", alpha=0.45, linewidth=0)
        middle = (low + high) / 2
        axis.plot([position - 0.35, position + 0.35], [middle, middle], color="0.35", linewidth=1.5)
    if row["mean"] is not None:
        interval = reach(Estimate(row["mean"], row["low"], row["high"]))
        axis.errorbar(position, row["mean"], interval, fmt="o", color=colour, capsize=4, linewidth=1.8, markersize=6)


def _add_legend(figure: Any) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    ours = Line2D([], [], marker="o", color="black", linewidth=1.8)
    published = Patch(color="0.6", alpha=0.45)
    handles = {"ours: mean, Student's 95 % interval": ours, "published: mean, 95 % interval of five seeds": published}
    legend_below(figure, handles, 2, fontsize="small")
