"""The style that all figures share: colours, orders, titles and axes."""

import contextlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from earl_jax.envs import PAPER_TASKS, make
from earl_jax.errors import InputError

COLOURS = {"naive": "#D55E00", "fbrl": "#0072B2", "r3l": "#009E73", "vaprl": "#CC79A7", "oracle": "#333333"}
"""The paper's methods in its order, each with its colour in every figure (the palette of Okabe and Ito)."""
OTHER_COLOURS = ("#E69F00", "#56B4E9", "#8C564B", "#7F7F7F", "#F0E442")
LINE_STYLES = ("-", "--", ":", "-.")
PICTURES = (".png", ".pdf", ".svg")
"""The suffixes of files that `save` writes."""


def new_figure(rows: int, columns: int, size: tuple[float, float], **options: Any) -> tuple[Any, Any]:
    """Return a figure of `size` inches and its axes [rows, columns].

    Raises:
        ValueError: matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise InputError("plots need matplotlib: pip install 'earl-jax[plot]'") from error
    figure = Figure(figsize=size, layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **options)


@contextlib.contextmanager
def text_size(points: float) -> Iterator[None]:
    """A context in which figures have text of `points` points.

    Raises:
        ValueError: matplotlib is not installed.
    """
    try:
        import matplotlib
    except ImportError as error:
        raise InputError("plots need matplotlib: pip install 'earl-jax[plot]'") from error
    with matplotlib.rc_context({"font.size": points}):
        yield


def save(figure: Any, path: Path) -> Path:
    """Write `figure` to `path` and return the path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=150)
    return path


def ordered(names: Iterable[str], first: Iterable[str]) -> list[str]:
    """Return each of `names` once: those in `first` in its order, then the others alphabetically."""
    leading, distinct = list(first), set(names)
    return [name for name in leading if name in distinct] + sorted(distinct - set(leading))


def task_order(envs: Iterable[str]) -> list[str]:
    """Return each of `envs` once: the paper's tasks in its order, then the others alphabetically."""
    return ordered(envs, PAPER_TASKS)


def method_order(algos: Iterable[str]) -> list[str]:
    """Return each of `algos` once: the paper's methods in its order, then the others alphabetically."""
    return ordered(algos, COLOURS)


def colours(algos: Iterable[str]) -> dict[str, str]:
    """Return the colour of each method; methods that the paper does not have share the other colours alphabetically."""
    names = method_order(algos)
    others = [name for name in names if name not in COLOURS]
    return {name: COLOURS.get(name) or OTHER_COLOURS[others.index(name) % len(OTHER_COLOURS)] for name in names}


def step_axis(axis: Any, label: str) -> None:
    """Format the x axis of `axis` as steps, with few and short numbers."""
    from matplotlib.ticker import EngFormatter

    axis.xaxis.set_major_formatter(EngFormatter(sep=""))
    axis.locator_params(axis="x", nbins=5)
    axis.set_xlabel(label)


def task_title(env: str) -> str:
    """Return the title of a task, or its name if it cannot be built here."""
    try:
        return make(env).title
    except ValueError:
        return env
