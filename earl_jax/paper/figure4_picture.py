"""The picture of figure 4: a map of visits for each method, and the thresholded difference of oracle and FBRL."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from earl_jax.paper.visit_maps import VisitMap
from earl_jax.report.style import COLOURS, method_order, new_figure, task_title

PLACES = "#D55E00"
PAIR = ("oracle", "fbrl")
"""The methods of the difference: the first one's share minus the second one's."""
THRESHOLD = 0.5
"""The least difference that is drawn, in units of the share of a bin with equal visits everywhere."""
THRESHOLD_TEXT = (
    f"Differences below {THRESHOLD} of the share of a bin with equal visits everywhere are white; the paper does not print "
    "its threshold. Circles are positions of the initial distribution, crosses those of goals."
)


def draw(maps: Sequence[VisitMap]) -> Any:
    """Return a figure with a row per task and a column per method, one logarithmic colour scale per row.

    The last column is the difference of `PAIR`.
    """
    from matplotlib.cm import ScalarMappable

    envs = list(dict.fromkeys(part.env for part in maps))
    algos = method_order(part.algo for part in maps)
    heights = [_relative_height(next(part for part in maps if part.env == env)) for env in envs]
    size = (3.4 * (len(algos) + 1) + 1.4, sum(3.1 * height + 0.7 for height in heights))
    figure, axes = new_figure(len(envs), len(algos) + 1, size, gridspec_kw={"height_ratios": heights})
    for axis in axes.flat:
        axis.set_axis_off()
    for env, line in zip(envs, axes, strict=True):
        row = {part.algo: part for part in maps if part.env == env}
        norm = _colour_norm(list(row.values()))
        for algo, part in row.items():
            _draw_map(line[algos.index(algo)], part, norm)
        if set(PAIR) <= row.keys():
            _draw_difference(line[-1], row)
        figure.colorbar(ScalarMappable(norm, "viridis"), ax=line.tolist(), label="share of visits in a bin")
    _add_legend(figure)
    return figure


def difference(oracle: VisitMap, other: VisitMap) -> np.ndarray:
    """Return in which bins [B, B] a method visits more: 1 the oracle, -1 the `other`, 0 less than the threshold."""
    change = oracle.shares - other.shares
    return np.sign(change) * (np.abs(change) > THRESHOLD / change.size)


def _relative_height(part: VisitMap) -> float:
    width, height = part.map_bounds[1] - part.map_bounds[0]
    return float(np.clip(height / width, 0.4, 1.6))


def _colour_norm(maps: Sequence[VisitMap]) -> Any:
    """Return the logarithmic scale from the least to the largest share of visits on any of `maps`."""
    from matplotlib.colors import LogNorm

    visited = np.concatenate([part.shares[part.shares > 0] for part in maps])
    low, high = (visited.min(), visited.max()) if len(visited) else (0.1, 1.0)
    return LogNorm(low if low < high else high / 10, high)


def _draw_map(axis: Any, part: VisitMap, norm: Any) -> None:
    shares = np.ma.masked_equal(part.shares.T, 0)
    _draw_image(axis, part, shares, norm=norm, cmap="viridis")
    _draw_places(axis, part)
    axis.set_title(f"{task_title(part.env)}, {part.algo}")


def _draw_difference(axis: Any, row: dict[str, VisitMap]) -> None:
    from matplotlib.colors import ListedColormap

    first, second = (row[algo] for algo in PAIR)
    colour_map = ListedColormap([COLOURS[PAIR[1]], "white", COLOURS[PAIR[0]]])
    _draw_image(axis, first, difference(first, second).T, cmap=colour_map, vmin=-1, vmax=1)
    _draw_places(axis, first)
    axis.set_title(f"{PAIR[0]} minus {PAIR[1]}")


def _draw_image(axis: Any, part: VisitMap, values: Any, **style: Any) -> None:
    (x_low, y_low), (x_high, y_high) = part.map_bounds
    axis.set_axis_on()
    axis.set_facecolor("white")
    axis.imshow(values, origin="lower", extent=(x_low, x_high, y_low, y_high), aspect="equal", **style)
    axis.set(xlabel=f"x, {part.unit}", ylabel=f"y, {part.unit}", xlim=(x_low, x_high), ylim=(y_low, y_high))


def _draw_places(axis: Any, part: VisitMap) -> None:
    """Mark the positions of the initial distribution, unless they are too many to see, and of the goals."""
    if part.starts is not None:
        few = part.starts if len(part.starts) < 10 else part.starts.mean(axis=0, keepdims=True)
        axis.plot(*few.T, "o", markersize=5, markerfacecolor="none", markeredgecolor=PLACES)
    if part.goals is not None:
        axis.plot(*part.goals.T, "x", markersize=5, markeredgecolor=PLACES)


def _add_legend(figure: Any) -> None:
    from matplotlib.patches import Patch

    handles = [Patch(color=COLOURS[algo], label=f"more visits of {algo}") for algo in PAIR]
    figure.legend(handles=handles, loc="outside lower right", ncols=2, frameon=False)
