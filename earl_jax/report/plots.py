"""Learning curves as pictures."""

import itertools
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from earl_jax.errors import require_known
from earl_jax.metrics.comparison import FEWEST_SEEDS
from earl_jax.metrics.scores import CONTINUING, RATES
from earl_jax.metrics.statistics import Estimate
from earl_jax.options.values import COUNT, counted, require
from earl_jax.report import style
from earl_jax.report.pooling import read_all
from earl_jax.report.published import released_beside
from earl_jax.report.runs import Curves, checked_labels, labels
from earl_jax.report.scores import evenly_spaced, in_as_many_steps, interval_of, require_curve, trailing
from earl_jax.runs.files import require_suffix, warn

RELEASED = {"color": "0.55"}
"""The style of the released runs of the paper."""
CYCLE = {
    "C0": "fbrl", "C1": "oracle", "C2": "r3l", "C3": "naive", "C4": "", "C5": "", "C6": "vaprl", "black": "", "C8": "", "C9": "",
}  # fmt: skip
"""Colours of lines without one of their own: matplotlib's, without its grey, which looks like that of the released runs.
Each has the name of the method whose colour in `style.COLOURS` looks like it; a picture of this method leaves it out."""
LETTER = 0.58 / 72
"""Width of a letter in inches per point of its size."""
POINTS = 2000
"""Largest number of evaluations that are drawn for a line, more than a panel has pixels."""


class Size(NamedTuple):
    """The `width` of a figure and the `height` of a panel in inches, the size of its text in points, its `columns`."""

    width: float
    height: float
    points: float
    columns: int

    def wrapped(self, text: str, columns: int, scale: float = 1.0) -> str:
        """Return `text` in lines that fit into one of so many columns of the figure, with letters `scale` times as large."""
        return textwrap.fill(text, int(self.width / (LETTER * self.points * scale * columns)) - 6)


SIZES = {"screen": Size(10, 4.2, 10, 2), "column": Size(3.35, 2.3, 8, 1), "page": Size(6.9, 2.6, 8, 2)}
"""A screen, and one column and both columns of a paper: 85 mm and 175 mm."""


class Line(NamedTuple):
    """A run to draw: its curves, and the name and the style of its line."""

    curves: Curves
    name: str
    style: dict[str, Any]


def caption(smooth: int = 1, published: bool = False) -> str:
    """Return what a picture of `plot_runs` shows, as the caption of a figure."""
    text = f"Means over seeds with 95 % intervals; of fewer than {FEWEST_SEEDS} seeds, each is drawn thin instead."
    if published:
        text = "Seeds thin and their means, over the paper's released seeds, where there are any, in grey with theirs."
    if smooth == 1:
        return f"{text} No smoothing."
    released = ", a released one of those in as many steps" if published else ""
    return f"{text} Each point is the mean of the trailing {smooth} evaluations{released}."


def plot_runs(
    folders: Sequence[str | Path],
    out: str | Path,
    names: Sequence[str] = (),
    metric: str | None = None,
    size: Literal["screen", "column", "page"] = "screen",
    smooth: int = 1,
    published: bool = False,
    copies: Sequence[str | Path] = (),
) -> Path:
    """Draw curves of `folders`, means with 95 % bands, and return `out`.

    Args:
        folders: run folders, or folders that contain them; each task and kind of reward has its own panels.
        out: the picture to write; `caption` describes it.
        names: names of the lines, in the order of `report.runs.labels`.
        metric: a column of metrics.csv to draw; by default the deployed and the continuing score.
        size: for a screen, or for one `column` or a whole `page` of a paper.
        smooth: evaluations in the trailing mean that is drawn; 1 draws evaluations as they are, at most 2,000 per line.
        published: whether to draw a panel for each run, with thin lines for its seeds over the paper's released seeds
            in grey, and both means.
        copies: further files to write the same picture to, of other suffixes for example.

    Raises:
        ValueError: a folder is not a run, a file has an unknown suffix, `names` are too few or too many, a run has no
            column `metric`, or matplotlib is not installed.
    """
    files = [Path(file) for file in (out, *copies)]
    for file in files:
        require_suffix(file, style.PICTURES, "pictures")
    require_known("size", size, SIZES)
    require("smooth", smooth, COUNT)
    lines = _lines(read_all(folders, check=lambda curves: require_curve(curves, metric)), names)
    with style.matplotlib().rc_context({"font.size": SIZES[size].points}):
        figure = _figure(lines, metric, SIZES[size], smooth, published)
        for file in files:
            style.save(figure, file)
    return files[0]


def _figure(lines: Sequence[Line], metric: str | None, layout: Size, smooth: int, published: bool) -> Any:
    """Return the figure of `lines`, in which each task and kind of reward, or if `published` each line, has its own panels."""
    tasks = style.task_order(line.curves.env for line in lines)
    by_task = sorted(lines, key=lambda line: tasks.index(line.curves.env))
    of_tasks = style.grouped(by_task, lambda line: (line.curves.env, metric or line.curves.deployed_metric)).values()
    groups = [[line] for of_task in of_tasks for line in of_task] if published else of_tasks
    cells = [(group, *panel) for group in groups for panel in _panels(group, metric)]
    columns = min(layout.columns, len(cells))
    rows = -(-len(cells) // columns)
    figure, axes = style.new_figure(rows, columns, (layout.width, layout.height * rows))
    released = False
    for axis, (group, drawn, heading) in zip(axes.flat, cells, strict=False):
        released |= _draw_panel(axis, group, drawn, smooth, published)
        names = [style.task_title(group[0].curves.env)] * (len(tasks) > 1) + [group[0].name] * published
        title = layout.wrapped(", ".join(names), columns, 1.2)  # as matplotlib enlarges titles
        axis.set_title("\n".join(filter(None, (title, heading))))
    for axis in axes.flat[len(cells) :]:
        axis.set_visible(False)
    if len(tasks) == 1:
        figure.suptitle(style.task_title(tasks[0]))
    _add_legend(figure, lines, layout, released)
    return figure


def _lines(runs: Sequence[Curves], names: Sequence[str]) -> list[Line]:
    """Return the lines of `runs`; lines of different tasks that have the same name have the same style."""
    given = labels(runs)
    distinct = list(dict.fromkeys(given))
    titles = map(style.plain, checked_labels(names, distinct)) if names else map(style.method_title, distinct)
    renamed = dict(zip(distinct, titles, strict=True))
    cycle = [colour for colour, similar in CYCLE.items() if similar not in distinct]
    marks = itertools.cycle(itertools.product(style.LINE_STYLES, cycle))
    marked = {name: ("-", style.COLOURS[name]) if name in style.COLOURS else next(marks) for name in distinct}
    looks = {name: {"linestyle": dashes, "color": colour} for name, (dashes, colour) in marked.items()}
    return [Line(curves, renamed[name], looks[name]) for curves, name in zip(runs, given, strict=True)]


def _panels(lines: Sequence[Line], metric: str | None) -> list[tuple[str, str]]:
    """Return the metrics of the panels of `lines` and their headings: `metric`, or by default the two scores."""
    if metric is not None:
        return [(metric, "")]
    panels = [(lines[0].curves.deployed_metric, "Deployed, from s0"), (CONTINUING, "Continuing, over the lifetime")]
    return [panel for panel in panels if any(np.isfinite(line.curves.metrics[panel[0]]).any() for line in lines)]


def _draw_panel(axis: Any, lines: Sequence[Line], metric: str, smooth: int, published: bool) -> bool:
    """Draw a metric of `lines`, if `published` each seed over those of the paper, and return whether there were any of these."""
    beside = False
    for line in lines:
        released = released_beside(line.curves) if published else None
        if released is not None and metric in released.metrics:
            draw_curves(axis, released, metric, in_as_many_steps(smooth, line.curves, released), RELEASED, each=True)
            beside = True
        draw_curves(axis, line.curves, metric, smooth, line.style, each=published or line.curves.seeds < FEWEST_SEEDS)
    axis.set(ylabel=style.AXES.get(metric, metric), xlim=(0, None))
    if metric in RATES:
        axis.set_ylim(-0.03, 1.03)
    style.step_axis(axis)
    axis.grid(alpha=0.3)
    return beside


def draw_curves(axis: Any, curves: Curves, metric: str, smooth: int, look: dict[str, Any], each: bool) -> None:
    """Draw the mean over seeds of a metric with its 95 % band, or with `each` seed."""
    shown = evenly_spaced(len(curves.steps), POINTS)
    steps, values = curves.steps[shown], trailing(curves.metrics[metric], smooth)[:, shown]
    estimate = interval_of(curves, values, metric)
    band = Estimate(*[estimate.value] * 3) if each else estimate
    style.draw_band(axis, steps, band, alpha=0.2, **look)
    if each:
        axis.plot(steps, values.T, color=look["color"], alpha=0.3, linewidth=0.8, marker=style.dot(estimate.value))


def _add_legend(figure: Any, lines: Sequence[Line], layout: Size, released: bool) -> None:
    """Name the lines below the panels in as many lines of text as needed, with their seeds where all tasks have as many.

    Where styles repeat there is no legend, and a `RunWarning` says so.
    """
    count = len({line.name for line in lines})
    if count > len({tuple(line.style.values()) for line in lines}):
        warn(f"a picture of {count} lines has no legend, because their styles repeat")
        return
    entries: dict[str, dict[str, Any]] = {}
    for line in lines:
        counts = {other.curves.seeds for other in lines if other.name == line.name}
        seeds = f", {counted(line.curves.seeds, 'seed')}" if len(counts) == 1 else ""
        entries.setdefault(line.name + seeds, line.style)
    entries |= {"Published, five seeds": RELEASED} if released else {}
    columns = min(layout.columns, len(entries))
    filled = {layout.wrapped(name, columns): look for name, look in entries.items()}
    parts = np.array_split(list(filled), columns)  # as the legend fills its columns
    height = max(sum(name.count("\n") + 1 for name in part) for part in parts)
    figure.set_figheight(figure.get_figheight() + 1.35 * height * layout.points / 72)
    style.legend_below(figure, filled, columns)
