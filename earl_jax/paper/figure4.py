"""Figure 4 of the paper: positions of the gripper, peg or robot during training, by task and method.

Source: Sharma et al. 2022, figure 4.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from earl_jax.errors import InputError
from earl_jax.metrics.statistics import difference, stderr
from earl_jax.metrics.visitation import MEASURES, measure
from earl_jax.report.published import FEW, FEW_SEEDS, estimate_text, word_by_sign
from earl_jax.report.style import method_order, new_figure, save, task_order, task_title
from earl_jax.report.tables import markdown_table, write

UNCLEAR = "no clear difference"
DESCRIPTION = (
    "Visits to the bins of a square grid during training, mean over seeds (standard error). Covered: share of bins "
    "visited. Entropy: of the shares of visits, relative to that of equal visits everywhere. Concentration: share of "
    "visits in the most visited 1 % of bins."
)
PUBLISHED = (
    "The published figure: the oracle's visits stay near the starts and the way to the goal, FBRL's spread wider. "
    "The verdict compares the entropies. It is `as published` if the 95 % interval of FBRL minus oracle lies above "
    f"0, `opposite to published` if it lies below 0, else `{UNCLEAR}`."
)


class VisitMap(NamedTuple):
    """Visits on one task with one method: int `visits [N, B, B]` of N seeds, first axis x, after `steps` steps.

    The bins divide `map_bounds`, [[x, y] low, [x, y] high] in `unit`.
    """

    env: str
    algo: str
    visits: np.ndarray
    map_bounds: np.ndarray
    steps: int
    unit: str = "m"

    @property
    def name(self) -> tuple[str, str]:
        """The task and the method."""
        return self.env, self.algo

    @property
    def scores(self) -> dict[str, np.ndarray]:
        """Each measure of spread as [N]."""
        rows = [measure(part) for part in self.visits]
        return {name: np.array([row[name] for row in rows]) for name in MEASURES}

    @property
    def shares(self) -> np.ndarray:
        """Share of the visits of all seeds in each bin, [B, B]."""
        return self.visits.sum(axis=0) / max(self.visits.sum(), 1)


def write_figure4(maps: Sequence[VisitMap], out: Path) -> list[Path]:
    """Write figure 4 from `maps` into `out` and return the files: csv of every seed, visits as csv, md, png.

    Raises:
        ValueError: there are no maps, one has a wrong shape, a task and method come twice, or matplotlib is not
            installed.
    """
    maps = _checked(maps)
    figure = _draw(maps)
    out.mkdir(parents=True, exist_ok=True)
    paths = [out / "figure4.csv", out / "figure4_visits.csv", out / "figure4.md"]
    write([row for visit_map in maps for row in _rows(visit_map)], paths[0])
    _write_visits(maps, paths[1])
    paths[2].write_text(_markdown(maps))
    return [*paths, save(figure, out / "figure4.png")]


def _checked(maps: Sequence[VisitMap]) -> list[VisitMap]:
    """Return `maps` in the paper's order. Errors as `write_figure4`."""
    if not maps:
        raise InputError("figure 4 needs at least one map of visits")
    maps = [
        visit_map._replace(visits=np.asarray(visit_map.visits), map_bounds=np.asarray(visit_map.map_bounds, float))
        for visit_map in maps
    ]
    for visit_map in maps:
        shape = visit_map.visits.shape
        if len(shape) != 3 or shape[1] != shape[2] or not all(shape) or visit_map.map_bounds.shape != (2, 2):
            name = ", ".join(visit_map.name)
            raise InputError(f"visits of {name}: expected [N, B, B] over [2, 2], got {shape}")
    names = [visit_map.name for visit_map in maps]
    if len(set(names)) < len(names):
        raise InputError(f"each task and method has one map, got {names}")
    envs, algos = task_order(env for env, _ in names), method_order(algo for _, algo in names)
    return sorted(maps, key=lambda visit_map: (envs.index(visit_map.env), algos.index(visit_map.algo)))


def _rows(visit_map: VisitMap) -> list[dict[str, Any]]:
    """Return one row per seed."""
    (x_low, y_low), (x_high, y_high) = visit_map.map_bounds.tolist()
    return [
        {
            "env": visit_map.env,
            "algo": visit_map.algo,
            "seed": seed,
            "steps": visit_map.steps,
            **measure(visits),
            "visits": int(visits.sum()),
            "bins": visit_map.visits.shape[1],
            "x_low": x_low,
            "x_high": x_high,
            "y_low": y_low,
            "y_high": y_high,
        }
        for seed, visits in enumerate(visit_map.visits)
    ]


def _write_visits(maps: Sequence[VisitMap], path: Path) -> None:
    lines = ["env,algo,x_bin,y_bin,visits"]
    for visit_map in maps:
        total = visit_map.visits.sum(axis=0)
        bins = np.argwhere(total).tolist()
        lines += [f"{visit_map.env},{visit_map.algo},{x},{y},{total[x, y]}" for x, y in bins]
    path.write_text("\n".join(lines) + "\n")


def _markdown(maps: Sequence[VisitMap]) -> str:
    lines = []
    for visit_map in maps:
        texts = [f"{scores.mean():.3f} ({stderr(scores):.3f})" for scores in visit_map.scores.values()]
        lines.append([*visit_map.name, len(visit_map.visits), f"{visit_map.steps:,}", *texts])
    header = ["env", "algo", "seeds", "steps", *MEASURES]
    verdicts = [_verdict(maps, env) for env in dict.fromkeys(visit_map.env for visit_map in maps)]
    parts = ["# Figure 4: positions visited during training", DESCRIPTION, markdown_table(header, lines), PUBLISHED]
    parts.append(markdown_table(["env", "entropy, FBRL minus oracle", "verdict"], verdicts))
    if any(len(visit_map.visits) < FEW for visit_map in maps):
        parts.append(FEW_SEEDS)
    return "\n\n".join(parts) + "\n"


def _verdict(maps: Sequence[VisitMap], env: str) -> list[str]:
    entropies = {visit_map.algo: visit_map.scores["entropy"] for visit_map in maps if visit_map.env == env}
    missing = [algo for algo in ("fbrl", "oracle") if algo not in entropies]
    if missing:
        return [env, "-", f"- (no {' and no '.join(missing)})"]
    estimate = difference(entropies["fbrl"], entropies["oracle"])
    word = word_by_sign(estimate, "as published", "opposite to published", UNCLEAR)
    return [env, estimate_text(estimate, 3), word]


def _draw(maps: Sequence[VisitMap]) -> Any:
    """Return a figure with a row per task and a column per method, one logarithmic colour scale per row."""
    from matplotlib.cm import ScalarMappable

    envs = list(dict.fromkeys(visit_map.env for visit_map in maps))
    algos = method_order(visit_map.algo for visit_map in maps)
    heights = [_relative_height(next(visit_map for visit_map in maps if visit_map.env == env)) for env in envs]
    size = (3.6 * len(algos) + 1.4, sum(3.1 * height + 0.7 for height in heights))
    figure, axes = new_figure(len(envs), len(algos), size, gridspec_kw={"height_ratios": heights})
    for axis in axes.flat:
        axis.set_axis_off()
    for env, line in zip(envs, axes, strict=True):
        row = [visit_map for visit_map in maps if visit_map.env == env]
        norm = _colour_norm(row)
        for visit_map in row:
            _draw_map(line[algos.index(visit_map.algo)], visit_map, norm)
        figure.colorbar(ScalarMappable(norm, "viridis"), ax=line.tolist(), label="share of visits in a bin")
    return figure


def _relative_height(visit_map: VisitMap) -> float:
    width, height = visit_map.map_bounds[1] - visit_map.map_bounds[0]
    return float(np.clip(height / width, 0.4, 1.6))


def _colour_norm(maps: Sequence[VisitMap]) -> Any:
    """Return the logarithmic scale from the least to the largest share of visits on any of `maps`."""
    from matplotlib.colors import LogNorm

    visited = np.concatenate([visit_map.shares[visit_map.shares > 0] for visit_map in maps])
    low, high = (visited.min(), visited.max()) if len(visited) else (0.1, 1.0)
    return LogNorm(low if low < high else high / 10, high)


def _draw_map(axis: Any, visit_map: VisitMap, norm: Any) -> None:
    (x_low, y_low), (x_high, y_high) = visit_map.map_bounds
    axis.set_axis_on()
    axis.set_facecolor("white")
    shares = np.ma.masked_equal(visit_map.shares.T, 0)
    axis.imshow(
        shares, norm=norm, cmap="viridis", origin="lower", extent=(x_low, x_high, y_low, y_high), aspect="equal"
    )
    title = f"{task_title(visit_map.env)}, {visit_map.algo}"
    axis.set(title=title, xlabel=f"x, {visit_map.unit}", ylabel=f"y, {visit_map.unit}")
