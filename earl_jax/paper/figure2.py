"""Figure 2 of the paper: the return of plain SAC by the number of steps between resets, with two TD updates.

Source: Sharma et al. 2022, figure 2. The biased update treats every time-out as a terminal state. The paper's learner is
the first version of SAC, ours the second.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from earl_jax.algos import SAC, Learner
from earl_jax.algos.method import TASK
from earl_jax.envs import make
from earl_jax.errors import InputError
from earl_jax.metrics.comparison import CANNOT_TELL, Sample, mean_interval
from earl_jax.metrics.scores import final_scores
from earl_jax.metrics.statistics import Estimate
from earl_jax.paper.artefact import Artefact, Block, Options, Report, Row
from earl_jax.report import style
from earl_jax.report.comparison import compared_texts, comparison_columns, untested, with_verdicts
from earl_jax.report.pooling import read_all
from earl_jax.report.runs import Curves, common_step
from earl_jax.report.scores import over_same_steps
from earl_jax.report.tables import interval_text, markdown_table, steps_text
from earl_jax.runs.config import RunConfig

TASKS = ("cheetah_run", "fish_swim")
HORIZONS = (1_000, 2_000, 5_000, 10_000, 20_000, 100_000, 200_000)
"""H_T, the steps between resets."""
STEPS = 1_000_000
"""Training steps, which the paper does not print: five lifetimes between resets at the longest horizon."""
UPDATES = {True: "without the biased update", False: "with the biased update"}
"""Names of the two TD updates by `timeout_bootstrap`."""
FINDINGS = {
    ("cheetah_run", True): "degrades",
    ("cheetah_run", False): "restored",
    ("fish_swim", True): "degrades",
    ("fish_swim", False): "degrades",
}
"""The paper's finding on the return as H_T grows, by task and `timeout_bootstrap`."""
SAC_NOTE = """The learner is SAC of arXiv 1812.05905. The paper cites arXiv 1801.01290 for this figure, which learns a state \
value and keeps its temperature: `--set fixed_temperature=true` keeps ours, and `reward_scale` sets the weight of the \
reward against it."""
OTHER_NOTE = "The paper's learner is SAC of arXiv 1801.01290. The list above names every other learner."
"""What the page says of the learner, where all runs have SAC and where not."""
RETURN = "deployed/return"
MISSING = "-"
TESTED = ("p", "adjusted p")
PLOT_STYLES = {True: ("#D55E00", "o-"), False: ("#0072B2", "s--")}
"""Colour and line of each TD update by `timeout_bootstrap`."""


Arms = dict[tuple[str, bool], dict[int, Curves]]
"""The runs of each task and update by their horizon, the shortest first; an update that was not run has none."""


def blocks(env: str) -> list[Block]:
    """Return the runs on one task: every horizon with both TD updates.

    A goal stays until the next reset: in the paper's words, the agent has to undo the task before it can practise it
    again. Naive RL in the deployment setting would draw another goal every 1,000 steps.
    """
    updates: Options = {"timeout_bootstrap": [False, True]}
    options: list[Options] = [{"train_horizon": list(HORIZONS)}]
    if len(make(env).goal_states) > 1:
        options = [{"train_horizon": h, "setting": "continuing", "goal_change": h} for h in HORIZONS]
    return [Block(env, ("naive",), STEPS, {**tied, **updates}, eval_every_factor=2) for tied in options]


def report(folders: Sequence[Path]) -> Report:
    """Return figure 2 from run folders of `naive`, with rows of the final returns and of every evaluation.

    Raises:
        ValueError: a folder is not a run, or its run has another method or no resets, runs of one point differ in other
            options, or matplotlib is not installed.
    """
    arms = _arms(read_all(folders))
    rows, curves = [], []
    for (env, update), arm in arms.items():
        for horizon, run in arm.items():
            key = {"env": env, "timeout_bootstrap": update, "train_horizon": horizon}
            final = mean_interval(_final(run)).columns("return")
            rows.append({**key, "steps": run.length, "seeds": run.seeds, **final})
            for step, returns in zip(run.steps.tolist(), run.metrics[RETURN].T, strict=True):
                curves.append({**key, "step": step, **mean_interval(returns).columns("return")})
    runs = [run for arm in arms.values() for run in arm.values()]
    parts = {
        "returns": _returns(arms),
        "findings": _findings(arms),
        "effects": _effects(arms),
        "missing": _missing(arms),
        "runs": "\n".join(dict.fromkeys(map(_run_note, runs))),
        "learner": SAC_NOTE if all(isinstance(_learner(run), SAC) for run in runs) else OTHER_NOTE,
    }
    return Report(parts, _draw(arms), {"": rows, "_curves": curves})


def _arms(runs: Sequence[Curves]) -> Arms:
    """Return the runs per task, update and horizon, in order."""
    arms: Arms = {}
    for curves in runs:
        config = curves.config
        if config.algo != "naive":
            raise InputError(f"figure 2 is made of runs of naive, not of {config.algo}")
        env, horizon = config.env, config.build_env().train_horizon
        if not horizon:
            raise InputError(f"figure 2 needs resets, and a run on {env} has none: train_horizon=0")
        update = bool(_learner(curves).timeout_bootstrap)
        arm = arms.setdefault((env, update), {})
        if horizon in arm:
            raise InputError(f"runs on {env} with H_T {horizon:,}, {UPDATES[update]}, differ in other options")
        arm[horizon] = curves
    envs = style.ordered((env for env, _ in arms), TASKS)
    keys = [(env, update) for env in envs for update in UPDATES]
    return {key: dict(sorted(arms.get(key, {}).items())) for key in keys}


def _horizons(arms: Arms) -> list[int]:
    return sorted({horizon for arm in arms.values() for horizon in arm})


def _final(run: Curves) -> np.ndarray:
    """Return the final returns [seeds], by the window of the run."""
    return final_scores(run.steps, run.metrics[RETURN], run.window)


def _run_note(run: Curves) -> str:
    """Return how long a run is, how the goal of its task changes, and with which temperature and reward scale it learns."""
    learner = _learner(run)
    text = f"learner {learner.name}"
    if isinstance(learner, SAC):
        kind = "fixed at" if learner.fixed_temperature else "learnt from"
        text = f"temperature {kind} {learner.initial_temperature:g}"
    lengths = f"{run.length:,} steps, {_goals_text(run.config)}"
    return f"- {run.config.env}: {lengths}, {text}, reward scale {learner.reward_scale:g}"


def _learner(run: Curves) -> Learner:
    return run.config.build_method().learner


def _goals_text(config: RunConfig) -> str:
    env = config.build_env()
    protocol = config.protocol(env)
    if len(env.goal_states) == 1:
        return "one goal"
    if protocol.goal_change == protocol.train_horizon:
        return "the target stays between resets"
    drawn = protocol.goal_change or config.build_method().phases[TASK].length
    return f"another target every {drawn:,} steps, with and without a reset"


def findings(arms: Arms) -> list[Row]:
    """Return for each arm with several horizons the test of the return at the shortest minus that at the longest."""
    rows = []
    for (env, update), arm in arms.items():
        if len(arm) > 1:
            ends = min(arm), max(arm)
            rows.append({"env": env, "update": update, "horizons": ends, **_test(*(arm[end] for end in ends))})
    return with_verdicts(rows, family=("env",))


def effects(arms: Arms) -> list[Row]:
    """Return for each task the test of the return with minus without the biased update, at the longest horizon of both."""
    rows = []
    for env in dict.fromkeys(env for env, _ in arms):
        without, biased = (arms[env, update] for update in UPDATES)
        if common := without.keys() & biased.keys():
            horizon = max(common)
            rows.append({"env": env, "horizon": horizon, **_test(biased[horizon], without[horizon])})
    return with_verdicts(rows, family=("env",))


def _test(first: Curves, second: Curves) -> Row:
    """Return the columns of Welch's test of two runs over the same steps; three seeds have no significant permutation."""
    step = common_step(first, second)
    if not step:
        return untested(MISSING)
    own, other = (Sample.of(_final(run)) for run in over_same_steps((first, second), step))
    return comparison_columns(own, other)


def verdict(finding: str, effect: str, published: str | None) -> str:
    """Return whether the verdicts on the fall of the return and on the biased `effect` agree with the `published` finding.

    Both are `above`, `below`, `cannot tell`, or `-` without a test. The rules are on the page.
    """
    if published is None or finding == MISSING:
        return MISSING
    if published == "restored":
        return "differs" if finding == "above" else "agrees" if effect == "above" else CANNOT_TELL
    return {"above": "agrees", "below": "differs"}.get(finding, CANNOT_TELL)


def _returns(arms: Arms) -> str:
    horizons = sorted({*HORIZONS, *_horizons(arms)})
    lines = []
    for (env, update), arm in arms.items():
        texts = {h: f"{interval_text(*mean_interval(_final(run)), '.1f')} ({run.seeds})" for h, run in arm.items()}
        lines.append([env, UPDATES[update], *(texts.get(horizon, MISSING) for horizon in horizons)])
    return markdown_table(["task", "update", *(f"{horizon:,}" for horizon in horizons)], lines)


def _findings(arms: Arms) -> str:
    effect = {row["env"]: row["verdict"] for row in effects(arms)}
    lines = []
    for row in findings(arms):
        published = FINDINGS.get((row["env"], row["update"]))
        words = [published or MISSING, verdict(row["verdict"], effect.get(row["env"], MISSING), published)]
        horizons = "{:,} and {:,}".format(*row["horizons"])
        tests = compared_texts(row, ".1f", above="degrades", below="improves")
        lines.append([row["env"], UPDATES[row["update"]], horizons, *tests, *words])
    header = ["task", "update", "H_T", "shortest minus longest [95 %]", *TESTED, "finding", "published", "verdict"]
    return markdown_table(header, lines)


def _effects(arms: Arms) -> str:
    tests = [(row, compared_texts(row, ".1f", above="helps", below="hurts")) for row in effects(arms)]
    lines = [[row["env"], f"{row['horizon']:,}", *texts] for row, texts in tests]
    header = ["task", "H_T", "return with minus without the biased update [95 %]", *TESTED, "the biased update"]
    return markdown_table(header, lines)


def _missing(arms: Arms) -> str:
    """Return which points of the published figure were not run."""
    lines = []
    for env, update in FINDINGS:
        missing = [f"{horizon:,}" for horizon in HORIZONS if horizon not in arms.get((env, update), {})]
        lines += [f"- {env}, {UPDATES[update]}: {'; '.join(missing)}"] if missing else []
    return "\n".join(["Not run, by H_T:", "", *lines]) if lines else "Every point of the published figure was run."


def _draw(arms: Arms) -> Any:
    """Return a figure with a row per task: learning curves of each TD update by horizon, then final returns."""
    envs = list(dict.fromkeys(env for env, _ in arms))
    figure, axes = style.new_figure(len(envs), len(UPDATES) + 1, (4.6 * (len(UPDATES) + 1), 3.7 * len(envs) + 0.4))
    horizons = _horizons(arms)
    for env, line in zip(envs, axes, strict=True):
        for update, axis in zip(UPDATES, line, strict=False):
            for horizon, run in arms[env, update].items():
                style.draw_band(axis, run.steps, mean_interval(run.metrics[RETURN]), _colour(horizon, horizons))
            axis.set(title=f"{style.task_title(env)}, {UPDATES[update]}", ylabel=style.AXES[RETURN])
            axis.sharey(line[0])
            axis.grid(alpha=0.3)
            style.step_axis(axis)
        _draw_final(line[-1], env, arms)
    lines = {f"Reset every {steps_text(horizon)}": {"color": _colour(horizon, horizons)} for horizon in horizons}
    names = {name.capitalize(): handle for name, handle in style.legend_entries(axes[:1, -1]).items()}
    style.legend_below(figure, lines | names, -(-(len(horizons) + 2) // 2))
    return figure


def _colour(horizon: int, horizons: Sequence[int]) -> Any:
    """Return the colour of a horizon, from the darkest of the shortest to the brightest of the longest."""
    return style.matplotlib().colormaps["viridis"](0.92 * horizons.index(horizon) / max(len(horizons) - 1, 1))


def _draw_final(axis: Any, env: str, arms: Arms) -> None:
    """Draw a task's final returns, moved sideways a little so that the intervals of both updates can be seen."""
    for update, name in UPDATES.items():
        arm, (colour, marks) = arms[env, update], PLOT_STYLES[update]
        estimate = Estimate(*np.reshape([mean_interval(_final(run)) for run in arm.values()], (-1, 3)).T)
        x = [horizon * (1.03 if update else 0.97) for horizon in arm]
        axis.errorbar(
            x, estimate.value, style.reach(estimate), fmt=marks, color=colour, label=name, capsize=3, markersize=5
        )
    axis.set(
        title=f"{style.task_title(env)}, final", xscale="log", xlabel="Steps between resets", ylabel="Final return"
    )
    ticks = sorted({horizon for update in UPDATES for horizon in arms[env, update]})
    axis.set_xticks(ticks, [steps_text(horizon) for horizon in ticks])
    axis.set_xticks([], minor=True)
    axis.grid(alpha=0.3)


FIGURE2 = Artefact("figure2", TASKS, blocks, report)
