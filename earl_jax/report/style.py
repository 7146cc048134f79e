"""Where pictures are drawn, and the look that all of them share: colours, names of tasks, axes of steps."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

TITLES = {
    "tabletop_organization": "Tabletop organization",
    "sawyer_door": "Sawyer door",
    "sawyer_peg": "Sawyer peg",
    "franka_kitchen": "Franka kitchen",
    "dhand_lightbulb": "DHand lightbulb",
    "minitaur_pen": "Minitaur pen",
    "cheetah_run": "Cheetah run",
    "fish_swim": "Fish swim",
}
"""Tasks in the paper's order."""
COLOURS = {"naive": "#D55E00", "fbrl": "#0072B2", "r3l": "#009E73", "vaprl": "#CC79A7", "oracle": "#333333"}
"""Methods in the paper's order, each with its colour in every figure (the palette of Okabe and Ito)."""
OTHERS = ("#E69F00", "#56B4E9", "#8C564B", "#7F7F7F", "#F0E442")
STYLES = ("-", "--", ":", "-.")


def canvas(rows: int, columns: int, size: tuple[float, float], **options: Any) -> tuple[Any, Any]:
    """Return a figure of `size` inches and its axes [rows, columns]; without matplotlib it is a ValueError."""
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ValueError("plots need matplotlib: pip install 'earl-jax[plot]'") from error
    figure = Figure(figsize=size, layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **options)


def save(figure: Any, path: Path) -> Path:
    """Write `figure` to `path` and return it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=150)
    return path


def ordered(names: Iterable[str], known: Iterable[str]) -> list[str]:
    """Return each of `names` once: those in `known` first, in its order, then the others by the alphabet."""
    found, first = set(names), list(known)
    return [name for name in first if name in found] + sorted(found - set(first))


def colours(algos: Iterable[str]) -> dict[str, str]:
    """Return the colour of each method; methods that the paper does not have share what is left, by the alphabet."""
    names = ordered(algos, COLOURS)
    rest = [name for name in names if name not in COLOURS]
    return {name: COLOURS.get(name) or OTHERS[rest.index(name) % len(OTHERS)] for name in names}


def step_axis(axis: Any, label: str) -> None:
    """Make the x axis of `axis` one of steps, with few and short numbers."""
    from matplotlib.ticker import EngFormatter

    axis.xaxis.set_major_formatter(EngFormatter(sep=""))
    axis.locator_params(axis="x", nbins=5)
    axis.set_xlabel(label)


def title(env: str) -> str:
    """Return the name of a task for people."""
    return TITLES.get(env, env)
