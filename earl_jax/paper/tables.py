"""Tables 1 and 2 of the paper out of run folders, beside the published numbers.

Source: Sharma et al. 2022, tables 1 and 2.
"""

import textwrap
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from earl_jax import assets
from earl_jax.metrics.statistics import mean_of, stderr
from earl_jax.paper.verdicts import FEW, FEW_SEEDS, RULE, interval, published, verdict
from earl_jax.report.runs import Cell, cells, described
from earl_jax.report.style import COLOURS, TITLES, canvas, colours, ordered, save, title
from earl_jax.report.tables import WINDOW, grid, write

HEADS = {
    1: "Table 1: what the final policy achieves when it is deployed",
    2: "Table 2: average reward over the lifetime",
}
WHAT = {
    1: "Success rate where rewards are sparse, return where they are dense; one last evaluation, as published.",
    2: "Task reward a step, averaged over all steps of a life (`continuing/reward` at the end).",
}
ESCAPED = "the released robots of naive and fbrl had left the pen, 9 to 11 m from goals within 0.6 m of its middle."
FAULTS = {
    (1, "sawyer_door"): "0.94 of vaprl is one lucky evaluation; the last ten of the released curves average 0.70.",
    (2, "sawyer_door"): "0.369 of r3l counts steps twice; the released arrays make it about 0.63 to 0.74.",
    (1, "minitaur_pen"): ESCAPED,
    (2, "minitaur_pen"): ESCAPED,
}
"""Known faults of published cells."""


def write_table(number: int, folders: Sequence[Path], out: Path) -> list[Path]:
    """Write table `number` of the paper (1 or 2) from run folders into `out` and return the files: csv, md, png.

    Raises:
        ValueError: the table is unknown, a folder is no run or has no evaluation, or matplotlib is not installed.
    """
    if number not in HEADS:
        raise ValueError(f"there is no table {number}; choose from {', '.join(map(str, HEADS))}")
    found = cells(folders)
    rows = table_rows(number, found)
    picture = _draw(number, rows)
    out.mkdir(parents=True, exist_ok=True)
    paths = [out / f"table{number}{suffix}" for suffix in (".csv", ".md")]
    write(rows, paths[0])
    paths[1].write_text(_markdown(number, rows))
    return [*paths, save(picture, out / f"table{number}.png")]


def table_rows(number: int, found: Sequence[Cell]) -> list[dict[str, Any]]:
    """Return one row a cell of table `number`, in the paper's order: those of `found`, and published ones without a run."""
    wanted = [(cell["env"], cell["algo"]) for cell in assets.published(f"table{number}")]
    had = [(cell.env, cell.algo) for cell in found]
    rows = []
    for env in ordered((env for env, _ in wanted + had), TITLES):
        for algo in ordered((algo for place, algo in wanted + had if place == env), COLOURS):
            runs = [cell for cell in found if (cell.env, cell.algo) == (env, algo)]
            rows += [_row(number, env, algo, cell) for cell in runs or [None]]
    return rows


def _row(number: int, env: str, algo: str, cell: Cell | None) -> dict[str, Any]:
    comparable = cell is None or cell.curves.comparable
    printed = (published(f"table{number}", env, algo) if comparable else None) or ("-", "-")
    bounds = interval(*printed)
    ours = _measured(number, cell)
    row = {
        "env": env,
        "algo": algo,
        "label": cell.label if cell else algo,
        "options": described(cell.curves.options) if cell else None,
        **ours,
        "published_mean": printed[0],
        "published_stderr": printed[1],
        "published_low": bounds[0] if bounds else None,
        "published_high": bounds[1] if bounds else None,
        **{f"published_steps_{end}": _published_steps(env).get(end) for end in ("low", "high")},
        "verdict": verdict(ours["mean"], bounds),
    }
    return {**row, "published_last10": _published_last10(env, algo) if comparable else None} if number == 1 else row


def _measured(number: int, cell: Cell | None) -> dict[str, Any]:
    """Return what the seeds of `cell` scored, None everywhere without a run."""
    names = ["metric", "seeds", "steps", "mean", "stderr", "low", "high"]
    names += ["last10", "last10_stderr"] if number == 1 else []
    if cell is None:
        return dict.fromkeys(names)
    metric = cell.curves.deployed_metric if number == 1 else "continuing/reward"
    curves = cell.curves.metrics[metric]
    recent = curves[:, -WINDOW:].mean(axis=1)
    estimate, error = mean_of(curves[:, -1]), float(stderr(curves[:, -1]))
    values = [metric, len(curves), int(cell.curves.steps[-1]), estimate.value, error, estimate.low, estimate.high]
    values += [float(recent.mean()), float(stderr(recent))] if number == 1 else []
    return dict(zip(names, values, strict=True))


def _published_steps(env: str) -> dict[str, int]:
    row = assets.published_row("steps", env=env)
    return {end: int(row[end]) for end in ("low", "high") if row}


def _published_last10(env: str, algo: str) -> str | None:
    return assets.published_row("crossings", env=env, algo=algo).get("last10") or None


def _digits(row: dict[str, Any]) -> int:
    return {"deployed/success": 3, "deployed/return": 2}.get(row["metric"], 4)


def _ours(row: dict[str, Any], value: str, error: str) -> str:
    if row["mean"] is None:
        return "-"
    return f"{row[value]:.{_digits(row)}f} ({row[error]:.{_digits(row)}f})"


def _cell(row: dict[str, Any]) -> str:
    if row["published_mean"] == "-":
        return f"{_ours(row, 'mean', 'stderr')} / - / -"
    theirs = row["published_mean"] + ("" if row["published_stderr"] == "-" else f" ({row['published_stderr']})")
    age = age_of(row)
    verdict = f"{row['verdict']} at {age} of the steps" if age else row["verdict"]
    return f"{_ours(row, 'mean', 'stderr')} / {theirs} / {verdict}"


def age_of(row: dict[str, Any]) -> str:
    """Return at which share of the published steps a verdict was reached, nothing where it was at all of them."""
    least = row["published_steps_low"]
    if row["verdict"] == "-" or not least or row["steps"] >= least:
        return ""
    return f"{100 * row['steps'] / least:.2g} %"


def _grid(rows: Sequence[dict[str, Any]], text: Callable[[dict[str, Any]], str]) -> str:
    """Return a markdown table of methods by tasks of `text(row)`."""
    envs = list(dict.fromkeys(row["env"] for row in rows))
    kept = {(row["label"], row["env"]): text(row) for row in rows}
    names = [
        row["label"] for algo in ordered((row["algo"] for row in rows), COLOURS) for row in rows if row["algo"] == algo
    ]
    lines = [[name, *(kept.get((name, env), "-") for env in envs)] for name in dict.fromkeys(names)]
    return grid(["method", *envs], lines)


def _markdown(number: int, rows: Sequence[dict[str, Any]]) -> str:
    parts = [f"# {HEADS[number]}", WHAT[number]]
    parts += [
        "Each cell: ours, mean (standard error) / published, mean (standard error) / verdict.",
        _grid(rows, _cell),
    ]
    if number == 1:
        parts.append(
            "Steadier, the mean of the last 10 evaluations: ours, mean (standard error) / of the released curves."
        )
        parts.append(
            _grid(rows, lambda row: f"{_ours(row, 'last10', 'last10_stderr')} / {row['published_last10'] or '-'}")
        )
    parts.append(RULE)
    if any(row["seeds"] is not None and row["seeds"] < FEW for row in rows):
        parts.append(FEW_SEEDS)
    run = [row for row in rows if row["seeds"] is not None]
    tasks = {row["env"] for row in run}
    faults = [f"- {env}: {text}" for (table, env), text in FAULTS.items() if table == number and env in tasks]
    if faults:
        parts.append("\n".join(["Known faults of published cells:", "", *faults]))
    parts.append(
        "\n".join(["Runs (the verdict on one shorter than published compares different ages):", "", *map(_note, run)])
    )
    return "\n\n".join([*parts, _missing(rows)]) + "\n"


def _missing(rows: Sequence[dict[str, Any]]) -> str:
    absent: dict[str, list[str]] = {}
    for row in rows:
        if row["seeds"] is None:
            absent.setdefault(row["env"], []).append(row["algo"])
    texts = [f"{env} ({', '.join(algos)})" for env, algos in absent.items()]
    return f"Not run, shown as `-`: {', '.join(texts)}." if texts else "Every published cell was run."


def _note(row: dict[str, Any]) -> str:
    low, high = row["published_steps_low"], row["published_steps_high"]
    theirs = "-" if low is None else f"{low:,}" if low == high else f"{low:,} to {high:,}"
    short = ", shorter than published" if low and row["steps"] < low else ""
    seeds = f"{row['seeds']} seed{'s' * (row['seeds'] > 1)}"
    return (
        f"- {row['env']}, {row['label']}: {row['steps']:,} steps (published {theirs}), {seeds}, {row['options']}{short}"
    )


def _draw(number: int, rows: Sequence[dict[str, Any]]) -> Any:
    """Return a figure with a panel a task that was run: our means with their intervals beside published ones."""
    envs = list(dict.fromkeys(row["env"] for row in rows if row["seeds"] is not None))
    columns = 2 if len(envs) == 4 else min(3, len(envs))
    lines = -(-len(envs) // columns)
    figure, axes = canvas(lines, columns, (max(4.6 * columns, 7.0), 3.3 * lines + 0.9))
    for axis in axes.flat[len(envs) :]:
        axis.set_axis_off()
    palette = colours(row["algo"] for row in rows)
    for env, axis in zip(envs, axes.flat, strict=False):
        axis.use_sticky_edges = False
        part = [row for row in rows if row["env"] == env]
        for place, row in enumerate(part):
            _draw_cell(axis, place, row, palette[row["algo"]])
        names = [textwrap.shorten(row["label"], 40, placeholder=" …") for row in part]
        slant = {"rotation": 20, "ha": "right"} if any(row["label"] != row["algo"] for row in part) else {}
        axis.set_xticks(range(len(part)), names, fontsize="small", **slant)
        axis.set(title=title(env), xlim=(-0.6, len(part) - 0.4))
        axis.set_ylabel(
            {"deployed/success": "success", "deployed/return": "return"}.get(_metric(part), "reward a step")
        )
        axis.grid(axis="y", alpha=0.3)
    figure.suptitle(HEADS[number])
    _legend(figure)
    return figure


def _metric(part: Sequence[dict[str, Any]]) -> str:
    return next(row["metric"] for row in part if row["metric"])


def _draw_cell(axis: Any, place: int, row: dict[str, Any], colour: str) -> None:
    if row["published_low"] is not None:
        low, high = row["published_low"], row["published_high"]
        axis.bar(place, high - low, 0.7, low, color="0.6", alpha=0.45, linewidth=0)
        middle = (low + high) / 2
        axis.plot([place - 0.35, place + 0.35], [middle, middle], color="0.35", linewidth=1.5)
    if row["mean"] is not None:
        reach = [[row["mean"] - row["low"]], [row["high"] - row["mean"]]]
        axis.errorbar(
            place, row["mean"], np.maximum(reach, 0), fmt="o", color=colour, capsize=4, linewidth=1.8, markersize=6
        )


def _legend(figure: Any) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    ours = Line2D([], [], marker="o", color="black", linewidth=1.8, label="ours: mean, 95 % bootstrap interval")
    theirs = Patch(color="0.6", alpha=0.45, label="published: mean, 95 % interval of five seeds")
    figure.legend(handles=[ours, theirs], loc="outside lower center", ncols=2, frameon=False, fontsize="small")
