"""Figure 4 of the paper: where the gripper, peg or robot has been during training, by task and method.

Source: Sharma et al. 2022, figure 4.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from earl_jax.metrics.statistics import difference, stderr
from earl_jax.metrics.visitation import MEASURES, measure
from earl_jax.paper.verdicts import FEW, FEW_SEEDS, bracketed, told
from earl_jax.report.style import COLOURS, TITLES, canvas, ordered, save, title
from earl_jax.report.tables import grid, write

UNITS = {"tabletop_organization": "table units"}
TEXT = (
    "Visits of a square grid of bins during training, mean over seeds (standard error). Covered: share of bins visited. "
    "Entropy: of the shares of visits, relative to that of equal visits everywhere. Concentration: share of visits in the "
    "most visited 1 % of bins."
)
PUBLISHED = (
    "The published picture: the oracle's visits stay near the starts and the way to the goal, FBRL's spread wider. The "
    "verdict asks whether FBRL's entropy is higher: `as published` where the 95 % interval of FBRL minus oracle lies above "
    "0, `the other way round` where below, else `no difference told`."
)


class Map(NamedTuple):
    """Visits of one task under one method: int `visits [N, B, B]` of N seeds, x before y, over `area` after `steps` steps.

    `area` is [[x, y] low, [x, y] high] in the task's units.
    """

    env: str
    algo: str
    visits: np.ndarray
    map_bounds: np.ndarray
    steps: int


def write_figure4(maps: Sequence[Map], out: Path) -> list[Path]:
    """Write figure 4 from `maps` into `out` and return the files: csv a seed, md, visits as csv, png.

    Raises:
        ValueError: there are no maps, one has another shape, a task and method come twice, or matplotlib is not installed.
    """
    maps = _checked(maps)
    picture = _draw(maps)
    out.mkdir(parents=True, exist_ok=True)
    paths = [out / "figure4.csv", out / "figure4_visits.csv", out / "figure4.md"]
    write([row for one in maps for row in _rows(one)], paths[0])
    _write_visits(maps, paths[1])
    paths[2].write_text(_markdown(maps))
    return [*paths, save(picture, out / "figure4.png")]


def _checked(maps: Sequence[Map]) -> list[Map]:
    """Return `maps` in the paper's order."""
    if not maps:
        raise ValueError("figure 4 needs at least one map of visits")
    maps = [one._replace(visits=np.asarray(one.visits), map_bounds=np.asarray(one.map_bounds, float)) for one in maps]
    for one in maps:
        shape = one.visits.shape
        if len(shape) != 3 or shape[1] != shape[2] or not all(shape) or one.map_bounds.shape != (2, 2):
            raise ValueError(f"visits of {one.env}, {one.algo}: expected [N, B, B] over [2, 2], got {shape}")
    names = [(one.env, one.algo) for one in maps]
    if len(set(names)) < len(names):
        raise ValueError(f"a task and method have one map each, got {names}")
    envs, algos = ordered((env for env, _ in names), TITLES), ordered((algo for _, algo in names), COLOURS)
    return sorted(maps, key=lambda one: (envs.index(one.env), algos.index(one.algo)))


def _rows(one: Map) -> list[dict[str, Any]]:
    (x_low, y_low), (x_high, y_high) = one.map_bounds.tolist()
    area = {"x_low": x_low, "x_high": x_high, "y_low": y_low, "y_high": y_high}
    rest = {"visits": 0, "bins": one.visits.shape[1], **area}
    return [
        {
            "env": one.env,
            "algo": one.algo,
            "seed": seed,
            "steps": one.steps,
            **measure(part),
            **rest,
            "visits": int(part.sum()),
        }
        for seed, part in enumerate(one.visits)
    ]


def _write_visits(maps: Sequence[Map], path: Path) -> None:
    lines = ["env,algo,x_bin,y_bin,visits"]
    for one in maps:
        total = one.visits.sum(axis=0)
        lines += [f"{one.env},{one.algo},{x},{y},{total[x, y]}" for x, y in np.argwhere(total).tolist()]
    path.write_text("\n".join(lines) + "\n")


def _scores(one: Map) -> dict[str, np.ndarray]:
    """Return each measure as [seeds]."""
    found = [measure(part) for part in one.visits]
    return {name: np.array([row[name] for row in found]) for name in MEASURES}


def _markdown(maps: Sequence[Map]) -> str:
    lines = []
    for one in maps:
        texts = [f"{scores.mean():.3f} ({stderr(scores):.3f})" for scores in _scores(one).values()]
        lines.append([one.env, one.algo, len(one.visits), f"{one.steps:,}", *texts])
    header = ["env", "algo", "seeds", "steps", *MEASURES]
    verdicts = [_verdict(maps, env) for env in dict.fromkeys(one.env for one in maps)]
    parts = ["# Figure 4: places visited during training", TEXT, grid(header, lines), PUBLISHED]
    parts.append(grid(["env", "entropy, FBRL minus oracle", "verdict"], verdicts))
    if any(len(one.visits) < FEW for one in maps):
        parts.append(FEW_SEEDS)
    return "\n\n".join(parts) + "\n"


def _verdict(maps: Sequence[Map], env: str) -> list[str]:
    spread = {one.algo: _scores(one)["entropy"] for one in maps if one.env == env}
    absent = [algo for algo in ("fbrl", "oracle") if algo not in spread]
    if absent:
        return [env, "-", f"- (no {' and no '.join(absent)})"]
    estimate = difference(spread["fbrl"], spread["oracle"])
    return [env, bracketed(estimate, 3), told(estimate, "as published", "the other way round", "no difference told")]


def _draw(maps: Sequence[Map]) -> Any:
    """Return a figure with a row a task and a column a method, one logarithmic colour scale a row."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LogNorm

    envs, algos = list(dict.fromkeys(one.env for one in maps)), ordered((one.algo for one in maps), COLOURS)
    spans = [next(one.map_bounds[1] - one.map_bounds[0] for one in maps if one.env == env) for env in envs]
    shape = [float(np.clip(span[1] / span[0], 0.4, 1.6)) for span in spans]
    size = (3.6 * len(algos) + 1.4, sum(3.1 * tall + 0.7 for tall in shape))
    figure, axes = canvas(len(envs), len(algos), size, gridspec_kw={"height_ratios": shape})
    for axis in axes.flat:
        axis.set_axis_off()
    for env, line in zip(envs, axes, strict=True):
        row = [one for one in maps if one.env == env]
        shares = [one.visits.sum(axis=0) / max(one.visits.sum(), 1) for one in row]
        seen = np.concatenate([part[part > 0] for part in shares])
        low, high = (seen.min(), seen.max()) if len(seen) else (0.1, 1.0)
        norm = LogNorm(low if low < high else high / 10, high)
        for one, part in zip(row, shares, strict=True):
            _draw_map(line[algos.index(one.algo)], one, part, norm)
        figure.colorbar(ScalarMappable(norm, "viridis"), ax=line.tolist(), label="share of visits in a bin")
    return figure


def _draw_map(axis: Any, one: Map, shares: np.ndarray, norm: Any) -> None:
    (x_low, y_low), (x_high, y_high) = one.map_bounds
    axis.set_axis_on()
    axis.set_facecolor("white")
    seen = np.ma.masked_equal(shares.T, 0)
    axis.imshow(seen, norm=norm, cmap="viridis", origin="lower", extent=(x_low, x_high, y_low, y_high), aspect="equal")
    unit = UNITS.get(one.env, "m")
    axis.set(title=f"{title(one.env)}, {one.algo}", xlabel=f"x, {unit}", ylabel=f"y, {unit}")
