"""Learning curves as pictures."""

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from earl_jax.errors import InputError
from earl_jax.metrics.comparison import mean_interval
from earl_jax.metrics.statistics import Estimate
from earl_jax.report.runs import Curves, checked_labels, labels, read_all
from earl_jax.report.scores import SHARES, trailing
from earl_jax.report.style import (
    LINE_STYLES,
    PICTURES,
    draw_band,
    legend_below,
    matplotlib,
    new_figure,
    save,
    task_order,
)
from earl_jax.report.tables import seeds_text, steps_text

PANELS = {"deployed": "Deployed, from s0", "continuing": "Continuing, over the lifetime"}
AXES = {"deployed/success": "success", "deployed/return": "return", "continuing/reward": "reward per step"}
COLOUR_COUNT = 10
"""Colours of matplotlib's cycle."""
LETTER = 0.58 / 72
"""Width of a letter in inches per point of its size."""
FEWEST = 3
"""Fewest seeds that have a band; of fewer, each is drawn."""


class Size(NamedTuple):
    """The `width` of a figure and the `height` of a panel in inches, the size of its text in points, its `columns`."""

    width: float
    height: float
    points: float
    columns: int


SIZES = {"screen": Size(10, 4.2, 10, 2), "column": Size(3.35, 2.3, 8, 1), "page": Size(6.9, 2.6, 8, 2)}
"""A screen, and one column and both columns of a paper: 85 mm and 175 mm."""


class Line(NamedTuple):
    """A run to draw: its curves, the name of its line, and the number that gives its colour and dashes."""

    curves: Curves
    name: str
    number: int

    @property
    def style(self) -> dict[str, Any]:
        """The colour, and dashes for those beyond ten colours."""
        dashes = LINE_STYLES[self.number // COLOUR_COUNT % len(LINE_STYLES)]
        return {"color": f"C{self.number % COLOUR_COUNT}", "linestyle": dashes}


def caption(smooth: int = 1) -> str:
    """Return what a picture of `plot_runs` shows, as the caption of a figure."""
    text = f"Means over seeds with Student's 95 % intervals; of fewer than {FEWEST} seeds, each is drawn thin instead."
    smoothing = f" Each point is the mean of the trailing {smooth} evaluations." if smooth > 1 else " No smoothing."
    return text + smoothing


def plot_runs(
    folders: Sequence[Path],
    out: Path,
    names: Sequence[str] = (),
    metric: str | None = None,
    size: Literal["screen", "column", "page"] = "screen",
    smooth: int = 1,
) -> Path:
    """Draw curves of `folders`, means with Student's 95 % bands, and return `out`.

    Args:
        folders: run folders, or folders of them such as a sweep's; each task has panels of its own.
        out: the picture to write; `caption` describes it.
        names: names of the lines, in the order of `report.runs.labels`.
        metric: a column of metrics.csv to draw; by default the deployed and the continuing score.
        size: for a screen, or for one `column` or a whole `page` of a paper.
        smooth: evaluations in the trailing mean that is drawn; 1 draws every evaluation.

    Raises:
        ValueError: a folder is no run, `out` has an unknown suffix, `names` are too few or too many, no run has the
            `metric`, or matplotlib is not installed.
    """
    if out.suffix not in PICTURES:
        raise InputError(f"{out}: pictures are written as {', '.join(PICTURES)}")
    if size not in SIZES or smooth < 1:
        raise InputError(f"size must be one of {', '.join(SIZES)}, and smooth at least 1, not {size} and {smooth}")
    lines = _lines(read_all(folders), names)
    tasks = task_order(line.curves.config.env for line in lines)
    cells = [(env, panel) for env in tasks for panel in (PANELS if metric is None else [metric])]
    layout = SIZES[size]
    columns = min(layout.columns, len(cells))
    rows = -(-len(cells) // columns)
    with matplotlib().rc_context({"font.size": layout.points}):
        figure, axes = new_figure(rows, columns, (layout.width, layout.height * rows))
        for axis, (env, panel) in zip(axes.flat, cells, strict=False):
            of_task = [line for line in lines if line.curves.config.env == env]
            _draw_panel(axis, of_task, panel, smooth, env if len(tasks) > 1 else "")
        for axis in axes.flat[len(cells) :]:
            axis.set_visible(False)
        if len(tasks) == 1:
            figure.suptitle(tasks[0])
        _add_legend(figure, lines, layout)
        return save(figure, out)


def _lines(runs: Sequence[Curves], names: Sequence[str]) -> list[Line]:
    """Return the lines of `runs`; lines of different tasks that have the same name have the same colour."""
    given = labels(runs)
    distinct = list(dict.fromkeys(given))
    renamed = dict(zip(distinct, checked_labels(names, distinct), strict=True))
    return [Line(curves, renamed[name], distinct.index(name)) for curves, name in zip(runs, given, strict=True)]


def _draw_panel(axis: Any, lines: Sequence[Line], panel: str, smooth: int, env: str) -> None:
    """Draw one metric of one task."""
    metric = {"continuing": "continuing/reward", "deployed": lines[0].curves.deployed_metric}.get(panel, panel)
    for line in lines:
        name = line.curves.deployed_metric if panel == "deployed" else metric
        _draw(axis, line, trailing(line.curves.metrics[name], smooth))
    title = "\n".join(filter(None, (env, PANELS.get(panel, ""))))
    axis.set(title=title, ylabel=AXES.get(metric, metric), xlabel="environment steps of a seed", xlim=(0, None))
    if metric in SHARES:
        axis.set_ylim(-0.03, 1.03)  # Student's intervals of few seeds reach beyond
    axis.xaxis.set_major_formatter(lambda step, _: steps_text(step))
    axis.locator_params(axis="x", nbins=6)
    axis.grid(alpha=0.3)


def _draw(axis: Any, line: Line, values: np.ndarray) -> None:
    """Draw the mean over seeds of `values [N, E]` with Student's band, or with each of up to two seeds."""
    estimate, few = mean_interval(values), len(values) < FEWEST
    band = Estimate(*[estimate.value] * 3) if few else estimate
    draw_band(axis, line.curves.steps, band, alpha=0.2, **line.style)
    if few:
        axis.plot(line.curves.steps, values.T, color=line.style["color"], alpha=0.3, linewidth=0.8)


def _add_legend(figure: Any, lines: Sequence[Line], layout: Size) -> None:
    """Name the lines below the panels, with as many lines of text as their names need there."""
    from matplotlib.lines import Line2D

    entries = _legend_entries(lines)
    columns = min(layout.columns, len(entries))
    letters = int(layout.width / (LETTER * layout.points * columns)) - 6
    handles = {textwrap.fill(name, letters): Line2D([], [], **line.style) for name, line in entries.items()}
    height = max(sum(name.count("\n") + 1 for name in list(handles)[i::columns]) for i in range(columns))
    figure.set_figheight(figure.get_figheight() + 1.35 * height * layout.points / 72)
    legend_below(figure, handles, columns)


def _legend_entries(lines: Sequence[Line]) -> dict[str, Line]:
    """Return a line for each text of the legend: names, with the number of seeds where it is the same on all tasks."""
    entries: dict[str, Line] = {}
    for line in lines:
        counts = {other.curves.seeds for other in lines if other.number == line.number}
        name = f"{line.name}, {seeds_text(line.curves.seeds)}" if len(counts) == 1 else line.name
        entries.setdefault(name, line)
    return entries
