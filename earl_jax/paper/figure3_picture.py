"""The picture of figure 3: a map of visits for each method, and the thresholded difference of oracle and FBRL."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from earl_jax.envs import Map
from earl_jax.report.style import COLOURS, method_order, method_title, new_figure, task_title

PLACES = "#D55E00"
PAIR = ("oracle", "fbrl")
"""The methods of the difference: the first one's share minus the second one's."""
THRESHOLD = 0.5
"""The least difference that is drawn, in units of the share of a bin with equal visits everywhere."""


def draw(tasks: Mapping[str, Map], shares: Mapping[tuple[str, str], np.ndarray]) -> Any:
    """Return a figure with a row per task and a column per method, one logarithmic colour scale per row.

    The last column is the difference of `PAIR`.

    Args:
        tasks: the maps of the tasks by their names.
        shares: the shares of visits [B, B] by the names of task and method, first axis x.
    """
    algos = method_order(algo for _, algo in shares)
    heights = [_relative_height(task_map) for task_map in tasks.values()]
    size = (3.4 * (len(algos) + 1) + 1.4, sum(3.1 * height + 0.7 for height in heights))
    figure, axes = new_figure(len(tasks), len(algos) + 1, size, gridspec_kw={"height_ratios": heights})
    from matplotlib.cm import ScalarMappable
    from matplotlib.patches import Patch

    for axis in axes.flat:
        axis.set_axis_off()
    for (name, task_map), line in zip(tasks.items(), axes, strict=True):
        own = {algo: shares[name, algo] for algo in algos if (name, algo) in shares}
        norm = _colour_norm(list(own.values()))
        for algo, values in own.items():
            title = f"{task_title(name)}, {method_title(algo)}"
            _draw_map(
                line[algos.index(algo)], task_map, np.ma.masked_equal(values, 0), title, norm=norm, cmap="viridis"
            )
        if set(PAIR) <= own.keys():
            _draw_difference(line[-1], task_map, difference(*(own[algo] for algo in PAIR)))
        figure.colorbar(ScalarMappable(norm, "viridis"), ax=line.tolist(), label="Share of visits in a bin")
    handles = [Patch(color=COLOURS[algo], label=f"More visits of {method_title(algo)}") for algo in PAIR]
    figure.legend(handles=handles, loc="outside lower right", ncols=2, frameon=False)
    return figure


def difference(oracle: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return in which bins [B, B] the shares of visits of a method are larger: 1 `oracle`, -1 `other`, 0 below the threshold."""
    change = oracle - other
    return np.sign(change) * (np.abs(change) > THRESHOLD / change.size)


def _relative_height(task_map: Map) -> float:
    low, high = np.asarray(task_map.bounds)
    width, height = high - low
    return float(np.clip(height / width, 0.4, 1.6))


def _colour_norm(maps: Sequence[np.ndarray]) -> Any:
    """Return the logarithmic scale from the least to the largest share of visits on any of `maps`."""
    from matplotlib.colors import LogNorm

    visited = np.concatenate([shares[shares > 0] for shares in maps])
    low, high = (visited.min(), visited.max()) if len(visited) else (0.1, 1.0)
    return LogNorm(low if low < high else high / 10, high)


def _draw_difference(axis: Any, task_map: Map, signs: np.ndarray) -> None:
    from matplotlib.colors import ListedColormap

    colour_map = ListedColormap([COLOURS[PAIR[1]], "white", COLOURS[PAIR[0]]])
    _draw_map(axis, task_map, signs, " minus ".join(map(method_title, PAIR)), cmap=colour_map, vmin=-1, vmax=1)


def _draw_map(axis: Any, task_map: Map, values: np.ndarray, title: str, **style: Any) -> None:
    """Draw `values [B, B]`, first axis x, with the positions of starts, or of their middle if there are many, and of goals."""
    (x_low, y_low), (x_high, y_high) = np.asarray(task_map.bounds)
    axis.set_axis_on()
    axis.set_facecolor("white")
    axis.imshow(values.T, origin="lower", extent=(x_low, x_high, y_low, y_high), aspect="equal", **style)
    x, y = (f"{name}, {task_map.unit}" for name in "xy")
    axis.set(title=title, xlabel=x, ylabel=y, xlim=(x_low, x_high), ylim=(y_low, y_high))
    if task_map.starts is not None:
        few = task_map.starts if len(task_map.starts) < 10 else task_map.starts.mean(axis=0, keepdims=True)
        axis.plot(*few.T, "o", markersize=5, markerfacecolor="none", markeredgecolor=PLACES)
    if task_map.goals is not None:
        axis.plot(*task_map.goals.T, "x", markersize=5, markeredgecolor=PLACES)
