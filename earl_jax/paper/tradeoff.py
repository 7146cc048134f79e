"""The trade-off that the paper's conclusion names: how well and how fast a policy is learnt, by interventions spent.

Source: Sharma et al. 2022, section 7, which asks for it by task and shows no figure. The exhibit is ours: the probability
epsilon of an intervention, and a budget h_max for help that the agent requests (appendix A.2).
"""

import itertools
import math
from collections.abc import Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from earl_jax.errors import InputError
from earl_jax.metrics.comparison import CANNOT_TELL, LEVEL, POWER, SPLITS, mean_interval
from earl_jax.metrics.scores import SUCCESS, deployed_area
from earl_jax.metrics.statistics import Estimate
from earl_jax.paper.artefact import Artefact, Block, Options, Report, Row, column, mean_text, methods_on
from earl_jax.report import style
from earl_jax.report.comparison import with_verdicts
from earl_jax.report.pooling import read_all
from earl_jax.report.runs import Curves
from earl_jax.report.scores import over_same_steps, seed_scores
from earl_jax.report.tables import markdown_table, number_text

TASKS = ("tabletop_organization", "sawyer_door")
METHODS = ("naive", "fbrl")
STEPS = 1_000_000
"""Training steps; the paper has no experiment on this trade-off, so all numbers are ours."""
CHANCES = (0.0, 1e-5, 1e-4, 1e-3, 5e-3)
"""epsilon: at the largest one an intervention follows after 200 steps on average, about as often as an episode ends."""
BUDGETS = (10.0, 100.0, 1_000.0)
"""h_max, at a cost of 1 for each intervention."""
LINE = ("env", "algo", "kind")
"""The columns that name a line of the picture."""
KINDS = {"epsilon": ("at random", "o-"), "budget": ("on request", "s--")}
"""The two ways in which interventions are given: what the picture calls them, and their lines."""
SPENT = ("interventions", "help/asked", "help/enforced")
"""The metrics whose sum is the number of interventions spent."""
WORDS = {"above": "helps", "below": "hurts"}
"""What a larger epsilon or budget does, by the verdict on the correlation."""
DECIMALS = 6
"""Decimals to which scores are ranked, because means of equal shares can differ by rounding."""
Lines = dict[tuple[Any, ...], list[list[Row]]]
"""By task, method and kind: the rows of each value, the smallest first."""


def blocks(env: str) -> list[Block]:
    """Return the runs on one task: every epsilon without a budget, and every budget without an epsilon."""
    varied: list[Options] = [{"intervention_chance": list(CHANCES)}, *({"budget": budget} for budget in BUDGETS)]
    return [Block(env, (algo,), STEPS, options) for algo in methods_on(env, METHODS) for options in varied]


def report(folders: Sequence[Path]) -> Report:
    """Return the trade-off from run folders, with a row per seed.

    Raises:
        ValueError: a folder is not a run, two runs of a point differ in other options, or matplotlib is not installed.
    """
    runs = read_all(folders)
    rows, metrics = seed_rows(runs), {run.config.env: run.deployed_metric for run in runs}
    by_line = style.grouped(rows, itemgetter(*LINE))
    lines = {name: list(style.grouped(line, itemgetter("value")).values()) for name, line in by_line.items()}
    return Report(
        {"points": _points_table(rows), "findings": _findings_table(lines), "level": str(LEVEL)},
        _draw(lines, metrics),
        {"": rows},
    )


def seed_rows(runs: Sequence[Curves]) -> list[Row]:
    """Return a row per seed, by task, method, kind and value; the runs of one line over the same steps, up to the last of all.

    Raises:
        ValueError: two runs of one value differ in other options, or a run ends before the first evaluation of another.
    """
    lines: dict[tuple[str, str, str], dict[float, Curves]] = {}
    for run in runs:
        env, algo, setting = run.config.env, run.config.algo, run.config.build_setting()
        kind = "epsilon" if setting.budget is None else "budget"
        value = float(setting.intervention_chance if setting.budget is None else setting.budget)
        line = lines.setdefault((env, algo, kind), {})
        if value in line:
            raise InputError(f"runs of {algo} on {env} with {kind} {value:g} differ in other options; name one of them")
        line[value] = run
    envs, algos = style.task_order(env for env, _, _ in lines), style.method_order(algo for _, algo, _ in lines)
    rows = []
    for name in [name for name in itertools.product(envs, algos, KINDS) if name in lines]:
        values, line = zip(*sorted(lines[name].items()), strict=True)
        for value, run in zip(values, over_same_steps(line, min(run.length for run in line)), strict=True):
            rows += _rows({**dict(zip(LINE, name, strict=True)), "value": value}, run)
    return rows


def _rows(key: Row, run: Curves) -> list[Row]:
    metrics, none = run.metrics, np.zeros(run.seeds)
    scores = {
        "interventions": sum((metrics[name][:, -1] for name in SPENT if name in metrics), none),
        "final": seed_scores(run),
        "deployed_area": deployed_area(run.steps, metrics[run.deployed_metric]),
        "ended": metrics["help/over"][:, -1] if key["kind"] == "budget" else none,
    }
    key = {**key, "steps": run.length}
    return [
        {**key, "lane": lane, **{name: float(values[lane]) for name, values in scores.items()}}
        for lane in range(run.seeds)
    ]


def finding(rows: Sequence[Row]) -> Row:
    """Return Spearman's correlation of final scores with the values of one line, before `with_verdicts`; nan if one is constant.

    p is that of the permutation test: of all pairings of scores and values, or of `SPLITS` drawn ones if there are more.
    """
    final = stats.rankdata(column(rows, "final").round(DECIMALS))
    value = stats.rankdata(column(rows, "value"))
    correlation = p = math.nan
    if np.ptp(final) > 0 and np.ptp(value) > 0:
        final, value = stats.zscore(final), stats.zscore(value)
        result = stats.permutation_test(
            (value,), lambda own, axis: (own * final).mean(axis), permutation_type="pairings", n_resamples=SPLITS, rng=0
        )
        correlation, p = float(result.statistic), float(result.pvalue)
    return {"env": rows[0]["env"], "difference": correlation, "p": p, "verdict": ""}


def _points_table(rows: Sequence[Row]) -> str:
    lines = []
    for (*name, value, steps), seeds in style.grouped(rows, itemgetter(*LINE, "value", "steps")).items():
        texts = [mean_text(column(seeds, score), ".3f") for score in ("final", "deployed_area")]
        spent, ended = mean_text(column(seeds, "interventions"), ",.1f"), f"{column(seeds, 'ended').mean():.2f}"
        lines.append([*name, f"{value:g}", len(seeds), f"{steps:,}", spent, *texts, ended])
    header = ["task", "method", "varied", "value", "seeds", "steps", "interventions", "final", "area", "ended"]
    return markdown_table(header, lines)


def _findings_table(lines: Lines) -> str:
    """Return a table of the finding of each line of several values, with its ends."""
    lines = {name: line for name, line in lines.items() if len(line) > 1}
    if not lines:
        return "No method has runs with two values, so there is no finding."
    tests = with_verdicts([finding(list(itertools.chain(*line))) for line in lines.values()], family=("env",))
    rows = []
    for (name, line), test in zip(lines.items(), tests, strict=True):
        ends = [
            " to ".join(format(column(end, score).mean(), digits) for end in (line[0], line[-1]))
            for score, digits in (("interventions", ",.0f"), ("final", ".3f"))
        ]
        p_texts = [number_text(test[p], ".3f", 0.001) for p in ("p", "p_holm")]
        seeds = sum(map(len, line))
        found = CANNOT_TELL + (f" (detectable {_detectable(seeds):.2f})" if seeds > 3 else ": fewer than four seeds")
        rows.append([*name, *ends, number_text(test["difference"], ".3f"), *p_texts, WORDS.get(test["verdict"], found)])
    header = ["task", "method", "varied", "interventions", "final", "rank correlation", "p", "adjusted p"]
    return markdown_table([*header, "a larger value"], rows)


def _detectable(seeds: int) -> float:
    """Return the rank correlation that four seeds or more show with a probability of 80 %, by Fisher's transformation."""
    return math.tanh((stats.norm.ppf(1 - LEVEL / 2) + stats.norm.ppf(POWER)) / math.sqrt(seeds - 3))


def _draw(lines: Lines, metrics: dict[str, str]) -> Any:
    """Return a figure with a column per task: final score and area by the interventions spent; `metrics` names the scores."""
    envs = list(dict.fromkeys(env for env, _, _ in lines))
    figure, axes = style.new_figure(2, len(envs), (max(4.8 * len(envs), 6.4), 7.0), sharex="col")
    palette = style.colours(algo for _, algo, _ in lines)
    for (env, algo, kind), line in lines.items():
        name, marks = KINDS[kind]
        look = {"fmt": marks, "color": palette[algo], "label": f"{style.method_title(algo)}, {name}"}
        for axis, score in zip(axes[:, envs.index(env)], ("final", "deployed_area"), strict=True):
            _draw_line(axis, line, score, metrics[env] == SUCCESS, **look)
    for env, (above, below) in zip(envs, axes.T, strict=True):
        above.set(title=style.task_title(env), ylabel=style.AXES[metrics[env]])
        mean = f"Mean {metrics[env].removeprefix('deployed/')} over training"
        below.set(xscale="symlog", xlabel="Interventions", ylabel=mean)
    for axis in axes.flat:
        axis.grid(alpha=0.3)
    style.legend_below(figure, style.legend_entries(axes[0]), 4)
    return figure


def _draw_line(axis: Any, line: Sequence[Sequence[Row]], score: str, rate: bool, **look: Any) -> None:
    """Draw one line, whose points are the values of epsilon or the budget."""
    spent = [column(seeds, "interventions").mean() for seeds in line]
    estimate = Estimate(*zip(*(mean_interval(column(seeds, score), rate) for seeds in line), strict=True))
    axis.errorbar(spent, estimate.value, style.reach(estimate), capsize=3, markersize=5, **look)


TRADEOFF = Artefact("tradeoff", TASKS, blocks, report)
