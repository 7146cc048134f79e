"""Maps of visited positions by task and method: their measures, and the files that hold them.

The measures and claims are those of figure 4 of Sharma et al. 2022.
"""

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from earl_jax.envs import Env, make
from earl_jax.errors import InputError
from earl_jax.metrics.visitation import mean_distance, measure, share_in_corners, share_near
from earl_jax.paper.tasks import FIGURE4_GOAL_RADIUS
from earl_jax.report.style import method_order, task_order
from earl_jax.report.tables import write

SCORES, VISITS = "figure4.csv", "figure4_visits.csv"


class VisitMap(NamedTuple):
    """Visits on one task with one method: int `visits [N, B, B]` of N seeds, first axis x, after `steps` steps.

    The bins divide `map_bounds`, [[x, y] low, [x, y] high] in `unit`. `starts` and `goals`, [K, 2] or None, are positions
    of the initial distribution and of goals. Maps of earlier versions hold the sum over `pooled` seeds, with N = 1.
    """

    env: str
    algo: str
    visits: np.ndarray
    map_bounds: np.ndarray
    steps: int
    unit: str = "m"
    starts: np.ndarray | None = None
    goals: np.ndarray | None = None
    pooled: int | None = None

    @property
    def name(self) -> tuple[str, str]:
        """The task and the method."""
        return self.env, self.algo

    @property
    def seeds(self) -> int:
        """The number of seeds in all maps."""
        return self.pooled or len(self.visits)

    @property
    def scores(self) -> dict[str, np.ndarray]:
        """Each measure as [N]: those of distance that this task has, then those of spread."""
        rows = [measure(part) for part in self.visits]
        return self._distances() | {name: np.array([row[name] for row in rows]) for name in rows[0]}

    def _distances(self) -> dict[str, np.ndarray]:
        places = [part for part in (self.starts, self.goals) if part is not None]
        scores = {"corners": share_in_corners(self.visits)}
        if len(places) == 2:
            scores = {"distance": mean_distance(self.visits, self.map_bounds, np.concatenate(places)), **scores}
        radius = FIGURE4_GOAL_RADIUS.get(self.env)
        if self.goals is not None and radius:
            scores["near_goal"] = share_near(self.visits, self.map_bounds, self.goals, radius)
        return scores

    @property
    def shares(self) -> np.ndarray:
        """Share of the visits of all seeds in each bin, [B, B]."""
        return self.visits.sum(axis=0) / max(self.visits.sum(), 1)


def visit_map(env: Env, algo: str, visits: np.ndarray, **fields: Any) -> VisitMap:
    """Return the map of `visits [N, B, B]` on the task `env`, which has `map_bounds`; further `fields` as given."""
    known = {"steps": int(visits[0].sum()), "map_bounds": env.map_bounds, "unit": env.map_unit}
    return VisitMap(env.name, algo, visits, **{**known, "starts": env.map_starts, "goals": env.map_goals, **fields})


def checked(maps: Sequence[VisitMap]) -> list[VisitMap]:
    """Return `maps` in the paper's order.

    Raises:
        ValueError: there are no maps, one has a wrong shape, or a task and method come twice.
    """
    if not maps:
        raise InputError("figure 4 needs at least one map of visits")
    maps = [
        part._replace(visits=np.asarray(part.visits), map_bounds=np.asarray(part.map_bounds, float)) for part in maps
    ]
    for part in maps:
        shape = part.visits.shape
        if len(shape) != 3 or shape[1] != shape[2] or not all(shape) or part.map_bounds.shape != (2, 2):
            raise InputError(f"visits of {', '.join(part.name)}: expected [N, B, B] over [2, 2], got {shape}")
    names = [part.name for part in maps]
    if len(set(names)) < len(names):
        raise InputError(f"each task and method has one map, got {names}")
    envs, algos = task_order(env for env, _ in names), method_order(algo for _, algo in names)
    return sorted(maps, key=lambda part: (envs.index(part.env), algos.index(part.algo)))


def write_maps(maps: Sequence[VisitMap], out: Path) -> list[Path]:
    """Write the measures and the visits of every seed of `maps` into `out` and return both files, which `read_maps` reads."""
    columns = list(dict.fromkeys(name for part in maps for name in part.scores))
    write([row for part in maps for row in _score_rows(part, columns)], out / SCORES)
    lines = ["env,algo,seed,x_bin,y_bin,visits"]
    for part in maps:
        lines += [
            f"{part.env},{part.algo},{seed},{x},{y},{part.visits[seed, x, y]}"
            for seed, x, y in np.argwhere(part.visits).tolist()
        ]
    (out / VISITS).write_text("\n".join(lines) + "\n")
    return [out / SCORES, out / VISITS]


def _score_rows(part: VisitMap, columns: Iterable[str]) -> list[dict[str, Any]]:
    """Return one row per seed."""
    (x_low, y_low), (x_high, y_high) = part.map_bounds.tolist()
    scores = part.scores
    return [
        {
            "env": part.env,
            "algo": part.algo,
            "seed": seed,
            "steps": part.steps,
            **{name: scores[name][seed] if name in scores else None for name in columns},
            "visits": int(visits.sum()),
            "bins": part.visits.shape[1],
            "x_low": x_low,
            "x_high": x_high,
            "y_low": y_low,
            "y_high": y_high,
        }
        for seed, visits in enumerate(part.visits)
    ]


def read_maps(folder: Path) -> list[VisitMap]:
    """Return the maps that `write_maps` wrote into `folder`.

    The file of visits of earlier versions has no seeds: each of its maps is the sum over all seeds.
    """
    scores, counts = (_rows_by_name(folder / name) for name in (SCORES, VISITS))
    maps = []
    for (env, algo), seeds in scores.items():
        rows, bins = counts.get((env, algo), []), int(seeds[0]["bins"])
        pooled = len(seeds) if rows and "seed" not in rows[0] else None
        visits = np.zeros((1 if pooled else len(seeds), bins, bins), int)
        for row in rows:
            visits[int(row.get("seed", 0)), int(row["x_bin"]), int(row["y_bin"])] = int(row["visits"])
        bounds = [[float(seeds[0][f"{axis}_{end}"]) for axis in "xy"] for end in ("low", "high")]
        fields = {"map_bounds": np.array(bounds), "steps": int(seeds[0]["steps"]), "pooled": pooled}
        maps.append(visit_map(make(env), algo, visits, **fields))
    return maps


def _rows_by_name(path: Path) -> dict[tuple[str, str], list[dict[str, str]]]:
    """Return the rows of a file by task and method."""
    rows: dict[tuple[str, str], list[dict[str, str]]] = {}
    with path.open() as handle:
        for row in csv.DictReader(handle):
            rows.setdefault((row["env"], row["algo"]), []).append(row)
    return rows
