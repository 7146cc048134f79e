"""The trade-off that the paper's conclusion names: how well and how fast a policy is learnt by the interventions spent.

Source: Sharma et al. 2022, section 7, which asks for it by task and shows no figure. The exhibit is ours: the probability
epsilon of an intervention, and a budget h_max for help that the agent requests (appendix A.2).
"""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from earl_jax.errors import InputError
from earl_jax.metrics.scores import deployed_area
from earl_jax.metrics.statistics import Estimate, difference, mean_of, stderr
from earl_jax.report.published import FEW, FEW_SEEDS, estimate_text, word_by_sign
from earl_jax.report.runs import Curves, read_all
from earl_jax.report.style import colours, method_order, new_figure, save, task_order, task_title
from earl_jax.report.tables import WINDOW, markdown_table, write

KINDS = {"epsilon": "o-", "budget": "s--"}
"""The two ways in which interventions are given, and their lines."""
SPENT = ("interventions", "help/asked", "help/enforced")
"""The metrics whose sum is the number of interventions spent."""
UNCLEAR = "no clear difference"
DESCRIPTION = (
    "Deployed score and interventions of whole lifetimes, mean over seeds (standard error). Epsilon is the probability of "
    "an intervention after any step, budget the largest total cost of help; both beside the interventions of every H_T "
    "steps. Final: the mean of a seed's last 10 evaluations. D(A): the area under its deployed curve per step, which is "
    "higher if it learns sooner. Interventions: all resets, requested and enforced help included. Ended: share of "
    "seeds whose budget was spent, so that their lifetime ended and they no longer learn."
)
RULES = (
    "Finding: the final score with the most minus that with the fewest interventions [95 % bootstrap interval]. More "
    f"interventions `help` if the interval lies above 0, `hurt` if it lies below 0, else `{UNCLEAR}`. The paper's conclusion "
    "names this trade-off and has no numbers for it."
)


class Point(NamedTuple):
    """The lifetimes of one method on one task with one epsilon or budget; arrays are [N] seeds.

    `mean_deployed`: the area under the deployed curve, per step.
    """

    env: str
    algo: str
    kind: str
    value: float
    final: np.ndarray
    mean_deployed: np.ndarray
    spent: np.ndarray
    ended: np.ndarray
    steps: int

    @property
    def name(self) -> tuple[str, str, str, float]:
        """The task, the method, the kind and its value."""
        return self[:4]


def write_tradeoff(folders: Sequence[Path], out: Path) -> list[Path]:
    """Write the trade-off from run folders into `out` and return the files: csv, md, png.

    Raises:
        ValueError: a folder is no run, two runs of one point differ in other options, or matplotlib is not installed.
    """
    points = _points(read_all(folders))
    figure = _draw(points)
    out.mkdir(parents=True, exist_ok=True)
    paths = [out / "tradeoff.csv", out / "tradeoff.md"]
    write([row for point in points for row in _rows(point)], paths[0])
    paths[1].write_text(_markdown(points))
    return [*paths, save(figure, out / "tradeoff.png")]


def _points(runs: Sequence[Curves]) -> list[Point]:
    """Return a point per run, by task, method, kind and value."""
    points = [_point(curves) for curves in runs]
    names = [point.name for point in points]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        env, algo, kind, value = twice[0]
        raise InputError(f"runs of {algo} on {env} with {kind} {value:g} differ in other options; name one of them")
    envs, algos = task_order(point.env for point in points), method_order(point.algo for point in points)
    kinds = list(KINDS)
    return sorted(
        points,
        key=lambda point: (envs.index(point.env), algos.index(point.algo), kinds.index(point.kind), point.value),
    )


def _point(curves: Curves) -> Point:
    setting, scores = curves.config.build_setting(), curves.metrics[curves.deployed_metric]
    budgeted = setting.budget is not None
    spent = [curves.metrics[name][:, -1] for name in SPENT if name in curves.metrics]
    return Point(
        env=curves.config.env,
        algo=curves.config.algo,
        kind="budget" if budgeted else "epsilon",
        value=float(setting.budget if setting.budget is not None else setting.intervention_chance),
        final=scores[:, -WINDOW:].mean(axis=1),
        mean_deployed=deployed_area(curves.steps, scores),
        spent=np.sum(spent, axis=0),
        ended=curves.metrics["help/over"][:, -1] if budgeted else np.zeros(len(scores)),
        steps=int(curves.steps[-1]),
    )


def _rows(point: Point) -> list[dict[str, Any]]:
    """Return one row per seed."""
    key = {"env": point.env, "algo": point.algo, "kind": point.kind, "value": point.value, "steps": point.steps}
    arrays = {
        "interventions": point.spent,
        "final": point.final,
        "deployed_area": point.mean_deployed,
        "ended": point.ended,
    }
    return [
        {**key, "lane": lane, **{name: float(values[lane]) for name, values in arrays.items()}}
        for lane in range(len(point.final))
    ]


def _lines(points: Iterable[Point]) -> dict[tuple[str, str, str], list[Point]]:
    """Return the points of each task, method and kind, from the fewest to the most interventions."""
    lines: dict[tuple[str, str, str], list[Point]] = {}
    for point in points:
        lines.setdefault(point.name[:3], []).append(point)
    return {name: sorted(line, key=lambda point: point.spent.mean()) for name, line in lines.items()}


def finding(line: Sequence[Point]) -> tuple[Estimate, str]:
    """Return the final score with the most minus that with the fewest interventions of one line, and the word for it."""
    estimate = difference(line[-1].final, line[0].final)
    return estimate, word_by_sign(estimate, "help", "hurt", UNCLEAR)


def _markdown(points: Sequence[Point]) -> str:
    header = ["env", "method", "varied", "value", "seeds", "steps", "interventions", "final", "D(A)", "ended"]
    table = markdown_table(header, [_line(point) for point in points])
    findings = []
    for name, line in _lines(points).items():
        if len(line) > 1:
            estimate, word = finding(line)
            counts = " and ".join(f"{end.spent.mean():,.0f}" for end in (line[0], line[-1]))
            findings.append([*name, counts, estimate_text(estimate, 3), word])
    parts = ["# Learning by interventions: the trade-off of the paper's conclusion", DESCRIPTION, table]
    if findings:
        header = ["env", "method", "varied", "fewest and most", "most minus fewest", "more interventions"]
        parts += [markdown_table(header, findings), RULES]
    if any(len(point.final) < FEW for point in points):
        parts.append(FEW_SEEDS)
    return "\n\n".join(parts) + "\n"


def _line(point: Point) -> list[str]:
    texts = [f"{values.mean():.3f} ({stderr(values):.3f})" for values in (point.final, point.mean_deployed)]
    spent = f"{point.spent.mean():,.1f} ({stderr(point.spent):,.1f})"
    counts = [str(len(point.final)), f"{point.steps:,}", spent]
    return [point.env, point.algo, point.kind, f"{point.value:g}", *counts, *texts, f"{point.ended.mean():.2f}"]


def _draw(points: Sequence[Point]) -> Any:
    """Return a figure with a column per task: final score and area by the interventions spent."""
    envs = list(dict.fromkeys(point.env for point in points))
    figure, axes = new_figure(2, len(envs), (max(4.8 * len(envs), 6.4), 7.0), sharex="col")
    palette = colours(point.algo for point in points)
    for (env, algo, kind), line in _lines(points).items():
        column = axes[:, envs.index(env)]
        for axis, name in zip(column, ("final", "mean_deployed"), strict=True):
            _draw_line(axis, line, name, palette[algo], KINDS[kind], f"{algo}, {kind}")
    for env, column in zip(envs, axes.T, strict=True):
        column[0].set(title=task_title(env), ylabel="final deployed score")
        column[1].set(xscale="symlog", xlabel="interventions spent", ylabel="area under the deployed curve, per step")
        for axis in column:
            axis.grid(alpha=0.3)
    handles = dict(pair for axis in axes[0] for pair in zip(*axis.get_legend_handles_labels()[::-1], strict=True))
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=4, frameon=False)
    return figure


def _draw_line(axis: Any, line: Sequence[Point], name: str, colour: str, style: str, label: str) -> None:
    """Draw one line, with the value of epsilon or the budget beside each point."""
    spent = [point.spent.mean() for point in line]
    estimates = [mean_of(getattr(point, name)) for point in line]
    means = [estimate.value for estimate in estimates]
    reach = np.maximum([[part.value - part.low, part.high - part.value] for part in estimates], 0).T
    options = {"color": colour, "label": label, "capsize": 3, "markersize": 5}
    axis.errorbar(spent, means, np.nan_to_num(reach), fmt=style, **options)
    for x, y, point in zip(spent, means, line, strict=True):
        axis.annotate(f"{point.value:g}", (x, y), (4, 4), textcoords="offset points", fontsize="x-small")
