"""CFBRL against the goals set for it, its options, and the life of each lane: `python -m benchmarks.paper.cfbrl`.

Reads the runs of results/leaderboard (the long ones), results/cfbrl (options at equal steps) and results/cfbrl_learning
(trials of learning on the peg), and writes all tables into results/cfbrl/tables.md, that of the goals into
examples/cfbrl/README.md too, and the picture results/cfbrl/curves.png.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.output import RESULTS, pages_with, shrink, write_files
from earl_jax.metrics.comparison import LEVEL, Sample, band, detectable_difference, holm, mean_interval, permutation
from earl_jax.metrics.crossings import CROSSING_WINDOW, crossing, trailing_mean
from earl_jax.metrics.deployed import WIDE
from earl_jax.metrics.phase_stats import ALIVE, BACK, FORWARD
from earl_jax.report.runs import Curves, read
from earl_jax.report.scores import interval_of, seed_scores
from earl_jax.report.style import AXES, draw_band, new_figure, task_title
from earl_jax.report.tables import interval_text, markdown_table, millions, step_interval

LONG, OPTIONS, LEARNING = RESULTS / "leaderboard", RESULTS / "cfbrl", RESULTS / "cfbrl_learning"
PAPER = RESULTS / "paper"
DEPLOYED = "deployed/success"
MEASURES = {DEPLOYED: "deployed", WIDE: "wide", FORWARD: "forward", BACK: "return", ALIVE: "alive"}
RUNS = {
    "tabletop_organization": ("cfbrl-averaged", "cfbrl", "cfbrl-utd_4"),
    "sawyer_door": ("cfbrl", "cfbrl-own_goals"),
    "sawyer_peg": ("cfbrl-around", "cfbrl-learning", "cfbrl-cloned"),
}
SHOWN = {
    "tabletop_organization": ("cfbrl-averaged",),
    "sawyer_door": ("cfbrl-own_goals",),
    "sawyer_peg": ("cfbrl-around",),
}
"""The run of each task beside its goals in the page."""
LANES = ("cfbrl-around", "cfbrl-cloned")
"""Runs of the peg without learning, of equal length."""
LEARNERS = {
    "sawyer_peg": ("cfbrl-around", "cfbrl-learning", "cfbrl-learning-cloning_30", "cfbrl-learning-cloning_100"),
    "sawyer_door": ("cfbrl-cloned", "cfbrl-own_goals", "cfbrl"),
}
"""Runs that learn beside one that does not, the first of each task."""
DENSE = "franka_kitchen", "dhand_lightbulb", "minitaur_pen"
RECENT, REACHED = "continuing/recent", "reached"
TITLES = {**MEASURES, RECENT: "reward per step", REACHED: "goals per 1,000 steps"}
REFERENCE = "own_goals"
TRIALS = (
    "foreign_goals",
    "foreign_goals-target_entropy_-32",
    "foreign_goals-cloning_100",
    REFERENCE,
    "own_goals-cloning_100",
)
"""Folders of the trials of learning on the peg; the reference has the settings of the first."""
LEARNS, LEARNT = 10_000, 15_000
"""Steps at which the actor begins to learn in these trials, and at which they are compared."""
RESET = 100_000
"""Steps between hard resets of the peg, of which a lane that is lost gets a new start."""
LIVES = 0.5
"""Share of the attempts since a reset from which a lane counts as having lived through that time."""


ABOUT = """`python -m benchmarks.paper.cfbrl` writes this page for [CFBRL](../../../examples/cfbrl/README.md). Runs are those of
[leaderboard](../leaderboard/README.md), this folder and [cfbrl_learning](../cfbrl_learning/README.md), means with 95 %
intervals over seeds. p is that of the permutation test against the first run or the reference, not adjusted but where the
text says so. `peg_lives.csv` has twelve lives of 20,000 steps of the shipped policy, by `benchmarks/peg_lives.py` of commit
4142734."""


class Goal(NamedTuple):
    """A goal: `metric` of the task reaches `level` before step `before`, or is there over the last `window` steps."""

    env: str
    metric: str
    level: float
    before: int | None = None
    window: int = 100_000


GOALS = (
    Goal("tabletop_organization", DEPLOYED, 0.9, before=150_000),
    Goal("tabletop_organization", DEPLOYED, 0.99),
    Goal("sawyer_door", DEPLOYED, 0.95, before=200_000),
    Goal("sawyer_door", DEPLOYED, 1.0, window=700_000),
    Goal("sawyer_peg", DEPLOYED, 0.95, window=1_000_000),
    Goal("sawyer_peg", WIDE, 0.8, window=1_000_000),
    Goal("sawyer_peg", FORWARD, 0.8, window=1_000_000),
    Goal("sawyer_peg", BACK, 0.8, window=1_000_000),
)


def goals_text(runs: Mapping[str, Sequence[str]]) -> str:
    """Return the table of the goals with what was measured in the `runs` of each task."""
    header = ("task", "run", "measure", "goal", "measured", "met")
    return markdown_table(header, [_goal_line(goal, name) for goal in GOALS for name in runs[goal.env]])


def _goal_line(goal: Goal, name: str) -> list[str]:
    curves, so_far = read(LONG / goal.env / name), False
    if goal.before is not None:
        at = crossing(curves.steps, curves.metrics[goal.metric], goal.level)
        text, met = f"at {step_interval(at)}", at.value < goal.before
        asked = f"{goal.level} before {millions(goal.before)}"
    else:
        mean = interval_of(curves, window_scores(curves, goal.metric, goal.window), goal.metric)
        text, met = interval_text(*mean), mean.value >= goal.level
        so_far = goal.window > curves.steps[-1]
        asked = (
            f"{goal.level} over the last {millions(min(goal.window, curves.steps[-1]))} of {millions(curves.steps[-1])}"
        )
    return [goal.env, name, MEASURES[goal.metric], asked, text, ("so far" if so_far else "yes") if met else "no"]


def window_scores(curves: Curves, metric: str, window: int, end: int | None = None) -> np.ndarray:
    """Return the mean [N] of each seed's `metric` over the last `window` steps up to `end`, by default that of the run.

    Evaluations without the metric do not count. Of `reached`, which counts from the first step, it is the goals in 1,000
    steps.
    """
    end = int(curves.steps[-1]) if end is None else end
    if metric == REACHED:
        first, last = (list(curves.steps).index(step) for step in (end - window, end))
        return (curves.metrics[metric][:, last] - curves.metrics[metric][:, first]) * 1000 / window
    inside = (curves.steps > end - window) & (curves.steps <= end)
    return np.nanmean(curves.metrics[metric][:, inside], axis=1)


def options_text() -> str:
    """Return the table of the options of results/cfbrl beside the default, over the last 200,000 steps, with Holm's p.

    A family has the measures of an option on a task.
    """
    rows, values = [], {}
    for env in sorted(path.name for path in OPTIONS.iterdir() if path.is_dir()):
        others = sorted(path.name for path in (OPTIONS / env).iterdir() if path.name != "default")
        runs = {name: read(OPTIONS / env / name) for name in ("default", *others)}
        scores = {name: [window_scores(run, metric, 200_000) for metric in MEASURES] for name, run in runs.items()}
        for name, own in scores.items():
            rows.append([env, name, *(interval_text(*mean_interval(score, rate=True)) for score in own)])
        for name in others:
            tests = [permutation(*pair).p for pair in zip(scores[name], scores["default"], strict=True)]
            values[env, name] = float(np.nanmin(holm(tests)))
    header = ("task", "options", *MEASURES.values())
    clear = [f"{name} on {env} ({p:.2g})" for (env, name), p in values.items() if p < LEVEL]
    smallest = (
        "Against the default, with the permutation test and p adjusted by Holm over the measures of an option on a task, the "
        f"seeds tell {' and '.join(clear) or 'no option'} apart; the smallest of the {len(values)} adjusted p is "
        f"{min(values.values()):.2g}."
    )
    return f"{markdown_table(header, rows)}\n\n{smallest}"


def learning_text() -> str:
    """Return the table of the trials of learning: success after the actor began, and p of phases against the reference."""
    runs = {name: read(LEARNING / name) for name in TRIALS}
    return _trials_table(runs, (FORWARD, BACK, WIDE, "entropy"), (FORWARD, BACK), REFERENCE, LEARNT - LEARNS, LEARNT)


def learners_text(env: str) -> str:
    """Return the table of the LEARNERS of a task: the 100,000 steps before the last that all have, p against the first."""
    runs = {name: read(LONG / env / name) for name in LEARNERS[env]}
    end = min(int(run.steps[-1]) for run in runs.values())
    metrics = (FORWARD, BACK, WIDE, RECENT, REACHED)
    table = _trials_table(runs, metrics, metrics, next(iter(runs)), CROSSING_WINDOW, end)
    samples = [
        [Sample.of(window_scores(run, metric, CROSSING_WINDOW, end)) for metric in metrics] for run in runs.values()
    ]
    found = [f"{TITLES[m]} {detectable_difference(*pair):.3f}" for m, *pair in zip(metrics, *samples[:2], strict=True)]
    return f"{table}\n\nUp to step {end:,}. Between the first two, a difference would be found of: {', '.join(found)}."


def _trials_table(
    runs: dict[str, Curves], metrics: Sequence[str], tested: Sequence[str], reference: str, window: int, end: int
) -> str:
    """Return a line for each run: means of `metrics` over `window`, and p of those `tested` against the run `reference`."""
    scores = {
        name: {metric: window_scores(run, metric, window, end) for metric in metrics} for name, run in runs.items()
    }
    rows = []
    for name, own in scores.items():
        pairs = [(own[metric], scores[reference][metric]) for metric in tested]
        tests = ["-" if name == reference else f"{permutation(*pair).p:.2g}" for pair in pairs]
        rows.append(
            [name, *(interval_text(*interval_of(runs[name], score, metric)) for metric, score in own.items()), *tests]
        )
    header = (
        "run",
        *(TITLES.get(metric, metric) for metric in metrics),
        *(f"p, {TITLES[metric]}" for metric in tested),
    )
    return markdown_table(header, rows)


def dense_text() -> str:
    """Return the table of the dense tasks: the scores of CFBRL and naive RL up to the last step of both."""
    lines = []
    for env in DENSE:
        runs = read(LONG / env / "cfbrl"), read(PAPER / env / "naive")
        end = min(int(run.steps[-1]) for run in runs)
        own, other = (seed_scores(run, step=end) for run in runs)
        test = permutation(own, other)
        intervals = interval_of(runs[0], own), interval_of(runs[1], other), (test.difference, test.low, test.high)
        texts = [interval_text(*interval, ".0f") for interval in intervals]
        lines.append([env, millions(end), *texts, f"{test.p:.2g}"])
    return markdown_table(("task", "steps", "CFBRL", "naive RL", "difference [95 %]", "p"), lines)


def lanes_text() -> str:
    """Return a table of the peg's lanes: forward success in each span between hard resets, and the spans lived through."""
    lines = []
    for name in LANES:
        curves = read(LONG / "sawyer_peg" / name)
        lines += [[name, str(seed), *cells] for seed, cells in zip(curves.config.seeds, _spans(curves), strict=True)]
    spans = len(lines[0]) - 3
    header = ("run", "seed", *(f"to {millions((number + 1) * RESET)}" for number in range(spans)), "lived through")
    return markdown_table(header, lines)


def _spans(curves: Curves) -> Iterator[list[str]]:
    """Yield the cells of each lane."""
    ends, forward = range(RESET, int(curves.steps[-1]) + 1, RESET), np.nan_to_num(curves.metrics[FORWARD])
    spans = [forward[:, (curves.steps > end - RESET) & (curves.steps <= end)].mean(axis=1) for end in ends]
    for shares in zip(*spans, strict=True):
        yield [*(f"{share:.2f}" for share in shares), f"{sum(share >= LIVES for share in shares)} of {len(shares)}"]


def draw() -> None:
    """Draw the curves of the long runs: a column a task, means with 95 % bands over 100,000 steps."""
    figure, grid = new_figure(2, len(RUNS), (11, 5.5), sharex="col", sharey=True)
    for column, (env, names) in zip(grid.T, RUNS.items(), strict=True):
        for axes, metrics in zip(column, ((DEPLOYED, WIDE), (FORWARD, BACK)), strict=True):
            for style, name in zip(("-", "--"), names, strict=False):
                _draw_lines(axes, read(LONG / env / name), metrics, style)
        column[0].set_title(task_title(env))
        column[1].set_xlabel("Steps (millions)")
    for axes, text in zip(grid[:, 0], (AXES[DEPLOYED], "Success of phases"), strict=True):
        axes.set_ylabel(text)
        axes.legend(loc="lower right", fontsize=8)
    picture = OPTIONS / "curves.png"
    figure.savefig(picture, dpi=120)
    shrink(picture)


def _draw_lines(axes: Any, curves: Curves, metrics: tuple[str, ...], style: str) -> None:
    for color, metric in zip(("C0", "C1"), metrics, strict=True):
        scores = trailing_mean(curves.steps, np.nan_to_num(curves.metrics[metric]))
        line = {"linestyle": style, "linewidth": 1.5, "label": MEASURES[metric] if style == "-" else None}
        draw_band(axes, curves.steps / 1e6, band(scores, rate=True), color, **line)
    axes.set_ylim(0, 1.03)


def files() -> dict[Path, str]:
    """Return the page of all tables, and that of the example with the table of the goals."""
    tables = {
        "The goals set before the runs": goals_text(RUNS),
        "Forward success on the peg in each span between hard resets": lanes_text(),
        "Learning on the peg, and cloning alone": learners_text("sawyer_peg"),
        "Learning on the door, and cloning alone": learners_text("sawyer_door"),
        "Trials of learning on the peg, with cloned goals of other demonstrations and of the own one": learning_text(),
        "Options without corrections, the last 200,000 steps": options_text(),
        "Dense tasks": dense_text(),
    }
    about = f"# All tables of CFBRL\n\n{ABOUT}"
    sections = [about, *(f"## {title}\n\n{table}" for title, table in tables.items())]
    return {OPTIONS / "tables.md": "\n\n".join(sections) + "\n", **pages_with({"goals": goals_text(SHOWN)})}


if __name__ == "__main__":
    write_files(files())
    draw()
