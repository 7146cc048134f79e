"""The paper's learning curves: deployed and continuing, one column a task."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from earl_jax import assets
from earl_jax.metrics.scores import deployed_area
from earl_jax.metrics.statistics import mean_of, stderr
from earl_jax.paper.verdicts import FEW, FEW_SEEDS, published
from earl_jax.report.runs import Cell, cells, described
from earl_jax.report.style import STYLES, canvas, colours, save, step_axis, title
from earl_jax.report.tables import LEVELS, crossing, grid, millions, trailing, write

TEXT = (
    "Deployed performance from s0 (mean of the trailing 10 evaluations) and reward a step over the lifetime; a line is the "
    "mean over seeds, its band the 95 % bootstrap interval of that mean. Dashes at the right edge are the published final "
    "values, crosses the steps at which the published mean curves first reached 0.5 and 0.9. curves.csv has single "
    "evaluations as well."
)
SMOOTH = " (trailing 10)"
COLUMNS = (
    "`to 0.5` and `to 0.9`: the step at which the mean curve, over its trailing 10 evaluations, first reached that success "
    "(`-`: not within the run, or judged by return). D(A): the area under the deployed curve divided by the steps, each "
    "evaluation standing for the steps since the one before; the paper's D(A) is the gap from there to the best policy. C(A): "
    "reward a step over the lifetime. J_D: the last evaluation. Brackets: standard errors."
)


def write_curves(folders: Sequence[Path], out: Path) -> list[Path]:
    """Write the learning curves of run folders into `out` and return the files: curves.csv, curves.md, curves.png.

    Raises:
        ValueError: a folder is no run or has no evaluation, or matplotlib is not installed.
    """
    found = cells(folders)
    rows = list(_points(found))
    picture = _draw(found, rows)
    out.mkdir(parents=True, exist_ok=True)
    write(rows, out / "curves.csv")
    (out / "curves.md").write_text(_markdown(found))
    return [out / "curves.csv", out / "curves.md", save(picture, out / "curves.png")]


def _metrics(cell: Cell) -> tuple[str, str]:
    return cell.curves.deployed_metric, "continuing/reward"


def _points(found: Sequence[Cell]) -> Iterator[dict[str, Any]]:
    """Yield the mean and its interval at every evaluation of every cell, deployed ones also smoothed."""
    for cell in found:
        deployed, lifetime = (cell.curves.metrics[metric] for metric in _metrics(cell))
        names = (cell.curves.deployed_metric, cell.curves.deployed_metric + SMOOTH, "continuing/reward")
        for metric, values in zip(names, (deployed, trailing(deployed), lifetime), strict=True):
            for step, scores in zip(cell.curves.steps.tolist(), values.T, strict=True):
                estimate = mean_of(scores)
                numbers = {"mean": estimate.value, "low": estimate.low, "high": estimate.high, "seeds": len(scores)}
                yield {"env": cell.env, "algo": cell.label, "step": step, "metric": metric, **numbers}


def _published(table: str, cell: Cell) -> str | None:
    """Return a printed mean, None where there is none or the run's reward is of another kind than the paper's."""
    printed = published(table, cell.env, cell.algo) if cell.curves.comparable else None
    return printed[0] if printed else None


def _crossings(cell: Cell) -> dict[float, int]:
    """Return the published step of each level that the published mean curve reached."""
    row = assets.published_row("crossings", env=cell.env, algo=cell.algo)
    same = cell.curves.deployed_metric == "deployed/success"
    return {level: int(row[f"steps_to_{level}"]) for level in LEVELS if same and row.get(f"steps_to_{level}")}


def _markdown(found: Sequence[Cell]) -> str:
    header = ["env", "algo", "seeds", "steps"]
    header += [text for level in LEVELS for text in (f"to {level}", "published")]
    header += ["D(A)", "C(A)", "published", "J_D", "published"]
    notes = [f"- {cell.env}, {cell.label}: {described(cell.curves.options)}" for cell in found]
    parts = ["# Learning curves", TEXT, grid(header, [_line(cell) for cell in found]), COLUMNS]
    if any(len(cell.curves.metrics["continuing/reward"]) < FEW for cell in found):
        parts.append(FEW_SEEDS)
    return "\n\n".join([*parts, "\n".join(["Options:", "", *notes])]) + "\n"


def _line(cell: Cell) -> list[str]:
    scores, rewards = (cell.curves.metrics[metric] for metric in _metrics(cell))
    steps, known = cell.curves.steps, _crossings(cell)
    rates = cell.curves.deployed_metric == "deployed/success"
    reached, digits = [], 3 if rates else 1
    for level in LEVELS:
        found = crossing(steps, scores.mean(axis=0), level) if rates else None
        reached += [f"{found:,}" if found else "-", millions(known.get(level))]

    def text(values: np.ndarray, digits: int) -> str:
        return f"{values.mean():.{digits}f} ({stderr(values):.{digits}f})"

    return [
        cell.env, cell.label, str(len(scores)), f"{steps[-1]:,}", *reached, text(deployed_area(steps, scores), digits),
        text(rewards[:, -1], 4), _published("table2", cell) or "-",
        text(scores[:, -1], digits), _published("table1", cell) or "-",
    ]  # fmt: skip


def _draw(found: Sequence[Cell], rows: Sequence[dict[str, Any]]) -> Any:
    """Return the figure of `rows`, which are the points of `found`."""
    envs = list(dict.fromkeys(cell.env for cell in found))
    figure, axes = canvas(2, len(envs), (max(4.4 * len(envs), 7.0), 6.6), sharex="col")
    palette = colours(cell.algo for cell in found)
    for cell in found:
        peers = [other.label for other in found if (other.env, other.algo) == (cell.env, cell.algo)]
        style = STYLES[peers.index(cell.label) % len(STYLES)]
        for axis, metric in zip(axes[:, envs.index(cell.env)], _metrics(cell), strict=True):
            render_state = metric if metric == "continuing/reward" else metric + SMOOTH
            part = [
                row for row in rows if (row["env"], row["algo"], row["metric"]) == (cell.env, cell.label, render_state)
            ]
            _draw_line(axis, part, palette[cell.algo], style, cell.label)
            _draw_published(axis, cell, metric, palette[cell.algo])
    for env, column in zip(envs, axes.T, strict=True):
        kind = next(cell.curves.deployed_metric for cell in found if cell.env == env)
        rates = kind == "deployed/success"
        column[0].set(title=title(env), ylabel="deployed success" if rates else "deployed return")
        if rates:
            column[0].set_ylim(-0.04, 1.04)
        column[1].set_ylabel("reward a step of the lifetime")
        column[0].set_xlim(0, max(cell.curves.steps[-1] for cell in found if cell.env == env))
        step_axis(column[1], "steps of a seed")
        for axis in column:
            axis.grid(alpha=0.3)
    _legend(figure, axes)
    return figure


def _legend(figure: Any, axes: Any) -> None:
    from matplotlib.lines import Line2D

    handles = dict(pair for axis in axes[0] for pair in zip(*axis.get_legend_handles_labels()[::-1], strict=True))
    handles["published: final value"] = Line2D([], [], color="0.5", linestyle="--", linewidth=2)
    handles["published: 0.5, 0.9 reached"] = Line2D([], [], color="0.5", linestyle="", marker="X", markersize=7)
    look = {"ncols": min(len(handles), 4 if axes.shape[1] < 3 else 8), "frameon": False, "fontsize": "small"}
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", **look)


def _draw_line(axis: Any, part: Sequence[dict[str, Any]], colour: str, style: str, name: str) -> None:
    steps, means, low, high = (np.array([row[key] for row in part]) for key in ("step", "mean", "low", "high"))
    marker = "o" if len(part) == 1 else None
    axis.plot(steps, means, style, color=colour, label=name, marker=marker, linewidth=1.4)
    axis.fill_between(steps, low, high, color=colour, alpha=0.18, linewidth=0)


def _draw_published(axis: Any, cell: Cell, metric: str, colour: str) -> None:
    """Draw the published final value as a dash at the right edge, and published crossings as crosses."""
    final = _published("table2" if metric == "continuing/reward" else "table1", cell)
    if final:
        height = float(final.lstrip("<"))
        edge = axis.get_yaxis_transform()
        axis.plot([1.015, 1.075], [height] * 2, "--", color=colour, linewidth=2, transform=edge, clip_on=False)
    if metric != "continuing/reward":
        for level, step in _crossings(cell).items():
            look = {"markersize": 8, "markeredgecolor": "white", "zorder": 5}
            axis.plot(step, level, "X", color=colour, **look)
