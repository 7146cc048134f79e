"""The style that all figures share: colours, orders, titles and axes."""

import importlib
import io
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from earl_jax.envs import PAPER_TASKS, list_envs
from earl_jax.errors import optional
from earl_jax.metrics.statistics import Estimate
from earl_jax.runs.files import written

TITLES = {"dhand_lightbulb": "DHand lightbulb"}
"""The titles of tasks whose name does not tell how to write it."""
METHODS = {
    "naive": "Naive RL", "fbrl": "FBRL", "r3l": "R3L", "vaprl": "VaPRL", "oracle": "Oracle RL", "cfbrl": "CFBRL",
    "medal": "MEDAL", "risc": "RISC", "rlpd": "RLPD", "bc": "Behaviour cloning",
}  # fmt: skip
"""The names of methods as people write them."""
AXES = {
    "deployed/success": "Success of the deployed policy",
    "deployed/return": "Return of the deployed policy",
    "continuing/reward": "Reward per step of the life",
}
"""What axes call metrics."""
UNITS = ((1_000_000, "Steps (millions)"), (1_000, "Steps (thousands)"))
COLOURS = {"naive": "#D55E00", "fbrl": "#0072B2", "r3l": "#009E73", "vaprl": "#CC79A7", "oracle": "#E69F00"}
"""The paper's methods in its order, each with its colour in every figure (the palette of Okabe and Ito)."""
OTHER_COLOURS = ("#6A3D9A", "#56B4E9", "#8C564B", "#F0E442", "#333333")
LINE_STYLES = ("-", "--", ":", "-.")
LEAST_BRIGHTNESS = 160
"""Least brightness of a colour on a dark page, 0 to 255."""
PICTURES = (".png", ".pdf", ".svg")
"""The suffixes of files that `save` writes."""


def matplotlib() -> Any:
    """Return the module `matplotlib`; a ValueError if it is not installed."""
    optional("matplotlib.figure", "plots need", "plot")
    return importlib.import_module("matplotlib")


def new_figure(rows: int, columns: int, size: tuple[float, float], **options: Any) -> tuple[Any, Any]:
    """Return a figure of `size` inches and its axes [rows, columns]. Errors as `matplotlib`."""
    figure = matplotlib().figure.Figure(figsize=size, layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **options)


def save(figure: Any, path: Path) -> Path:
    """Write `figure` to `path` and return the path."""
    content = io.BytesIO()
    with matplotlib().rc_context({"pdf.fonttype": 42}):  # TrueType: many conferences refuse the default, Type 3
        figure.savefig(content, format=path.suffix[1:], dpi=150)
    return written(path, content.getvalue())


def draw_band(axis: Any, x: Any, estimate: Estimate, color: Any, alpha: float = 0.15, **line: Any) -> None:
    """Draw the values of `estimate`, arrays over `x`, as a line with its interval as a band; a single value is a dot."""
    axis.plot(x, estimate.value, color=color, **{"linewidth": 1.3, "marker": dot(estimate.value), **line})
    axis.fill_between(x, estimate.low, estimate.high, color=color, alpha=alpha, linewidth=0)


def dot(values: Any) -> str | None:
    """Return the marker of a line through `values`: a dot if no two neighbours are numbers, as it could not be seen without."""
    drawn = np.isfinite(np.atleast_1d(values))
    return None if (drawn[1:] & drawn[:-1]).any() else "o"


def reach(estimate: Estimate) -> np.ndarray:
    """Return the distances [2, K] from the values of `estimate` to the ends of its interval, nan without an interval."""
    value, low, high = (np.atleast_1d(np.asarray(part, float)) for part in estimate)
    return np.maximum([value - low, high - value], 0)


def legend_below(figure: Any, entries: Mapping[str, Any], columns: int, **options: Any) -> None:
    """Put a legend of `entries` by their labels below the axes of `figure`: handles, or styles of lines."""
    from matplotlib.lines import Line2D

    handles = [Line2D([], [], **entry) if isinstance(entry, dict) else entry for entry in entries.values()]
    place = {"loc": "outside lower center", "ncols": columns, "frameon": False, **options}
    figure.legend(handles, entries.keys(), **place)


def legend_entries(axes: Iterable[Any]) -> dict[str, Any]:
    """Return the handles of the lines of `axes` by their labels, each label once."""
    return dict(pair for axis in axes for pair in zip(*axis.get_legend_handles_labels()[::-1], strict=True))


def ordered(names: Iterable[str], first: Iterable[str]) -> list[str]:
    """Return each of `names` once: those in `first` in its order, then the others alphabetically."""
    leading, distinct = list(first), set(names)
    return [name for name in leading if name in distinct] + sorted(distinct - set(leading))


def grouped(items: Iterable[Any], key: Callable[[Any], Any]) -> dict[Any, list[Any]]:
    """Return `items` by their `key`, in the order in which these occur."""
    groups: dict[Any, list[Any]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return groups


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


def mixed(colour: str, other: str, share: float) -> str:
    """Return `colour` (#RRGGBB) moved by `share` of the way to `other`."""
    pairs = zip(bytes.fromhex(colour[1:]), bytes.fromhex(other[1:]), strict=True)
    return "#" + "".join(f"{round(a + share * (b - a)):02X}" for a, b in pairs)


def lightened(colour: str) -> str:
    """Return `colour`, lightened if necessary so that it can be seen on black."""
    brightness = sum(bytes.fromhex(colour[1:])) / 3
    return mixed(colour, "#FFFFFF", max(0.0, LEAST_BRIGHTNESS - brightness) / (255 - brightness))


def shaded(colour: str, shade: int, count: int) -> str:
    """Return number `shade` of `count` shades of a colour, from dark to light; a single shade is the colour."""
    position = 2 * shade / (count - 1) - 1 if count > 1 else 0.0
    return mixed(colour, "#000000" if position < 0 else "#FFFFFF", 0.55 * abs(position))


def step_axis(axis: Any) -> None:
    """Format the x axis of `axis`, whose limits are set, as steps in thousands or millions, with few numbers."""
    last = axis.get_xlim()[1]
    unit, name = next(((unit, name) for unit, name in UNITS if last >= unit / 5), (1, "Steps"))
    axis.xaxis.set_major_formatter(lambda step, _: f"{step / unit:g}")
    axis.locator_params(axis="x", nbins=5)
    axis.set_xlabel(name)


def task_title(env: str) -> str:
    """Return the title of a task, or its name if it is not installed."""
    return TITLES.get(env, env.replace("_", " ").capitalize()) if env in list_envs() else env


def method_title(label: str) -> str:
    """Return the label of a method, such as `naive (reward_scale=1)`, with its name as people write it, for a picture."""
    name, bracket, options = label.partition(" (")
    return plain(f"{METHODS.get(name, name)}{bracket}{options}")


def plain(text: str) -> str:
    """Return `text` so that matplotlib draws its dollar signs and no mathematics."""
    return text.replace("$", r"\$")
