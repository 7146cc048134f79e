"""Figure 3 of the paper: positions of the gripper, peg or robot during training, by task and method.

Source: Sharma et al. 2022, figure 3 and section 6: where the oracle and FBRL spend their steps. The paper shows a
thresholded map of the difference; the measures and tests of its claims are ours.
"""

import math
from collections.abc import Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from earl_jax.envs import Map
from earl_jax.errors import InputError
from earl_jax.metrics import visitation
from earl_jax.metrics.comparison import LEVEL, Sample
from earl_jax.paper.artefact import Artefact, Report, Row, column, mean_text, runs_of
from earl_jax.report import style
from earl_jax.report.comparison import compared_texts, comparison_columns, untested, verdict_text, with_verdicts
from earl_jax.report.tables import markdown_table
from earl_jax.runs.folder import RunFolder
from earl_jax.training import load_visits

TASKS = ("tabletop_organization", "sawyer_peg", "minitaur_pen")
METHODS = ("fbrl", "oracle")
CLAIMS = (
    ("tabletop_organization", "distance"),
    ("tabletop_organization", "corners"),
    ("sawyer_peg", "distance"),
    ("sawyer_peg", "near_goal"),
    ("minitaur_pen", "distance"),
)
"""Tasks and measures of visits that are larger for FBRL than for the oracle in the paper. In its words the oracle stays
around the initial and goal distributions, while autonomous operation skews the gripper towards the corners, leaves the peg
stuck around the goal box, and lets the Minitaur go away from the goals."""
GOAL_RADIUS = {"sawyer_peg": 0.12}
"""Distance in metres of a visit to a goal that counts as near, by task (ours): the block reaches 0.1 m from its middle."""
MEASURES = ("distance", "corners", "near_goal", *visitation.MEASURES)
UNEQUAL = "not tested: the runs end at different steps"
"""The verdict where they do: a run has the map of its end alone."""
WORDS = {"above": "as published", "below": "opposite to published"}
STARTS, GOALS = (
    {"marker": marker, "linestyle": "", "markersize": 5, "markerfacecolor": "none", "color": "#D55E00"}
    for marker in "ox"
)
"""The styles of places on the maps."""
PAIR = ("oracle", "fbrl")
"""The methods of the difference in the picture: the first one's share minus the second one's."""
THRESHOLD = 0.5
"""The least difference that is drawn, in units of the share of a bin with equal visits everywhere."""


class VisitMap(NamedTuple):
    """Visits on the map of a task with one method: int `visits [N, B, B]` of N seeds, first axis x."""

    env: str
    map: Map
    algo: str
    visits: np.ndarray

    @property
    def shares(self) -> np.ndarray:
        """Share of the visits of all seeds in each bin, [B, B]."""
        return self.visits.sum(axis=0) / max(self.visits.sum(), 1)


def report(folders: Sequence[Path]) -> Report:
    """Return figure 3 from the maps of visited positions of run folders, which need no checkpoints.

    Raises:
        ValueError: a folder is not a run or has neither policies nor a checkpoint, or `report_of` raises it.
    """
    read = [(folder.config.algo, *load_visits(folder)) for folder in map(RunFolder.open, folders)]
    return report_of(
        [VisitMap(env.name, env.map, algo, visits) for algo, env, visits in read if env.map and visits is not None]
    )


def report_of(maps: Sequence[VisitMap]) -> Report:
    """Return figure 3 from `maps`, with rows of the measures of every seed and of its visits.

    Raises:
        ValueError: there are no maps, a task and method come twice, or matplotlib is not installed.
    """
    by_name = {(part.env, part.algo): part for part in maps}
    if not maps or len(by_name) < len(maps):
        raise InputError(f"figure 3 needs one map of visits for each task and method, got {list(by_name)}")
    envs, algos = style.task_order(env for env, _ in by_name), style.method_order(algo for _, algo in by_name)
    maps = [by_name[name] for env in envs for algo in algos if (name := (env, algo)) in by_name]
    rows = [row for part in maps for row in seed_rows(part)]
    missing = {env: [algo for algo in METHODS if (env, algo) not in by_name] for env in envs}
    parts = {
        "radii": ", ".join(f"{radius} m ({env})" for env, radius in GOAL_RADIUS.items()),
        "measures": _measures_table(rows),
        "level": str(LEVEL),
        "verdicts": _verdicts_table(verdicts(rows)),
        "missing": "\n\n".join(
            f"No test on {env}: no map of {' or '.join(names)}." for env, names in missing.items() if names
        ),
        "threshold": str(THRESHOLD),
    }
    return Report(parts, _draw(maps), {"": rows, "_visits": [row for part in maps for row in _visit_rows(part)]})


def seed_rows(part: VisitMap) -> list[Row]:
    """Return a row per seed with the `MEASURES` of its map, None for a distance that its task has no places for."""
    bounds, starts, goals = part.map.bounds, part.map.starts, part.map.goals
    (x_low, y_low), (x_high, y_high) = bounds.tolist()
    rows = []
    for seed, visits in enumerate(part.visits):
        distance = near_goal = None
        if starts is not None and goals is not None:
            distance = visitation.mean_distance(visits, bounds, np.concatenate([starts, goals]))
        if goals is not None and part.env in GOAL_RADIUS:
            near_goal = visitation.share_near(visits, bounds, goals, GOAL_RADIUS[part.env])
        measures = {"distance": distance, "corners": visitation.share_in_corners(visits), "near_goal": near_goal}
        key = {"env": part.env, "algo": part.algo, "seed": seed, "steps": int(visits.sum())}
        grid = {"bins": len(visits), "x_low": x_low, "x_high": x_high, "y_low": y_low, "y_high": y_high}
        rows.append({**key, **measures, **visitation.measure(visits), **grid})
    return rows


def _visit_rows(part: VisitMap) -> list[Row]:
    key = {"env": part.env, "algo": part.algo}
    places = np.argwhere(part.visits).tolist()
    return [{**key, "seed": n, "x_bin": x, "y_bin": y, "visits": part.visits[n, x, y]} for n, x, y in places]


def _measures_table(rows: Sequence[Row]) -> str:
    lines = []
    for name, seeds in style.grouped(rows, itemgetter("env", "algo")).items():
        texts = [mean_text(column(seeds, each), ".3f") for each in MEASURES]
        lines.append([*name, len(seeds), f"{seeds[0]['steps']:,}", *texts])
    return markdown_table(["task", "method", "seeds", "steps", *(each.replace("_", " ") for each in MEASURES)], lines)


def verdicts(rows: Sequence[Row]) -> list[Row]:
    """Return a row per published claim about a task that `seed_rows` of both methods are about: means, test and verdict."""
    seeds, results = style.grouped(rows, itemgetter("env", "algo")), []
    for env, measure in CLAIMS:
        if all((env, algo) in seeds for algo in METHODS):
            fbrl, oracle = (column(seeds[env, algo], measure) for algo in METHODS)
            row = {"env": env, "measure": measure, "fbrl": fbrl.mean(), "oracle": oracle.mean()}
            ends = {column(seeds[env, algo], "steps").max() for algo in METHODS}  # a seed with faults has fewer visits
            tested = comparison_columns(Sample.of(fbrl), Sample.of(oracle)) if len(ends) == 1 else untested(UNEQUAL)
            results.append({**row, **tested})
    return with_verdicts(results, family=("env",))


def word(row: Row) -> str:
    """Return the verdict on the test of a claim, or the sign alone where it has no test."""
    if math.isnan(row["p_holm"]) and abs(row["difference"]) > 0:
        return f"{WORDS['above' if row['difference'] > 0 else 'below']}, not tested"
    return verdict_text(row, words=WORDS)


def _verdicts_table(results: Sequence[Row]) -> str:
    header = ["task", "measure", "FBRL", "oracle", "FBRL minus oracle", "p", "adjusted p", "verdict"]
    lines = []
    for row in results:
        means, tests = [f"{row[algo]:.3f}" for algo in METHODS], compared_texts(row, ".3f")[:-1]
        lines.append([row["env"], row["measure"].replace("_", " "), *means, *tests, word(row)])
    return markdown_table(header, lines)


def _draw(maps: Sequence[VisitMap]) -> Any:
    """Return a figure with a row per task, a column per method and one of the difference of `PAIR`; each row has a scale."""
    algos, tasks = style.method_order(part.algo for part in maps), {part.env: part.map for part in maps}
    sizes = [np.ptp(task_map.bounds, axis=0) for task_map in tasks.values()]
    heights = [float(np.clip(height / width, 0.4, 1.6)) for width, height in sizes]
    size = (3.4 * (len(algos) + 1) + 1.4, sum(3.1 * height + 0.7 for height in heights))
    figure, axes = style.new_figure(len(tasks), len(algos) + 1, size, gridspec_kw={"height_ratios": heights})
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch

    signs = {"cmap": ListedColormap([style.COLOURS[PAIR[1]], "white", style.COLOURS[PAIR[0]]]), "vmin": -1, "vmax": 1}
    for axis in axes.flat:
        axis.set_axis_off()
    for (name, task_map), line in zip(tasks.items(), axes, strict=True):
        own = {part.algo: part.shares for part in maps if part.env == name}
        norm = _colour_norm(list(own.values()))
        for algo, values in own.items():
            axis, title = line[algos.index(algo)], f"{style.task_title(name)}, {style.method_title(algo)}"
            _draw_map(axis, task_map, np.ma.masked_equal(values, 0), title, norm=norm, cmap="viridis")
        if set(PAIR) <= own.keys():
            larger = difference(*(own[algo] for algo in PAIR))
            _draw_map(line[-1], task_map, larger, " minus ".join(map(style.method_title, PAIR)), **signs)
        figure.colorbar(ScalarMappable(norm, "viridis"), ax=line.tolist(), label="Share of visits in a bin")
    entries = {f"More visits of {style.method_title(algo)}": Patch(color=style.COLOURS[algo]) for algo in PAIR}
    style.legend_below(figure, {"Starts": STARTS, "Goals": GOALS, **entries}, 4, loc="outside lower right")
    return figure


def difference(oracle: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return in which bins [B, B] the shares of visits of a method are larger: 1 `oracle`, -1 `other`, 0 below the threshold."""
    change = oracle - other
    return np.sign(change) * (np.abs(change) > THRESHOLD / change.size)


def _colour_norm(maps: Sequence[np.ndarray]) -> Any:
    """Return the logarithmic scale from the least to the largest share of visits on any of `maps`."""
    from matplotlib.colors import LogNorm

    visited = np.concatenate([shares[shares > 0] for shares in maps])
    low, high = (visited.min(), visited.max()) if len(visited) else (0.1, 1.0)
    return LogNorm(low if low < high else high / 10, high)


def _draw_map(axis: Any, task_map: Map, values: np.ndarray, title: str, **look: Any) -> None:
    """Draw `values [B, B]`, first axis x, with the positions of starts, or of their middle if there are many, and of goals."""
    (x_low, y_low), (x_high, y_high) = np.asarray(task_map.bounds)
    axis.set_axis_on()
    axis.set_facecolor("white")
    axis.imshow(values.T, origin="lower", extent=(x_low, x_high, y_low, y_high), aspect="equal", **look)
    x, y = (f"{name}, {task_map.unit}" for name in "xy")
    axis.set(title=title, xlabel=x, ylabel=y, xlim=(x_low, x_high), ylim=(y_low, y_high))
    if task_map.starts is not None:
        few = task_map.starts if len(task_map.starts) < 10 else task_map.starts.mean(axis=0, keepdims=True)
        axis.plot(*few.T, **STARTS)
    if task_map.goals is not None:
        axis.plot(*task_map.goals.T, **GOALS)


FIGURE3 = Artefact("figure3", TASKS, runs_of(*METHODS), report)
