"""Figure 2 of the paper: the return of plain SAC by the number of steps between resets, with two TD updates.

Source: Sharma et al. 2022, figure 2. The biased update treats every time-out as a terminal state. The paper's learner is
the first version of SAC; ours is the second, see `LEARNER`.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from earl_jax.algos.method import TASK
from earl_jax.errors import InputError
from earl_jax.metrics.statistics import Estimate, difference, mean_of
from earl_jax.paper.figure2_picture import draw
from earl_jax.paper.tasks import FIGURE2_FINDINGS, FIGURE2_HORIZONS, FIGURE2_TASKS
from earl_jax.report.published import FEW, FEW_SEEDS, estimate_text, word_by_sign
from earl_jax.report.runs import Curves, read_all
from earl_jax.report.scores import last_mean
from earl_jax.report.style import ordered, save
from earl_jax.report.tables import markdown_table, write
from earl_jax.runs.config import RunConfig

UPDATES = {True: "without the biased update", False: "with the biased update"}
"""Names of the two TD updates by `timeout_bootstrap`."""
UNCLEAR, INCONCLUSIVE, MISSING = "no clear difference", "inconclusive", "-"
NO_ESTIMATE = Estimate(math.nan, math.nan, math.nan)
DESCRIPTION = (
    "Final deployed return (mean of a seed's last 10 evaluations) of naive RL by H_T, the steps between resets: mean "
    "over seeds [95 % bootstrap interval] (seeds), `-` where nothing was run."
)
RULES = (
    "Finding: the return at the shortest minus that at the longest H_T. It is `degrades` if the 95 % interval lies "
    f"above 0, `improves` if it lies below 0, else `{UNCLEAR}`. Verdict: `agrees` with a published `degrades` if ours "
    "is the same; `agrees` with `restored` if ours does not degrade and the biased update helps at the longest H_T "
    f"(second table); `differs` if ours is the opposite; else `{INCONCLUSIVE}`."
)
LEARNER = (
    "The learner is SAC of arXiv 1812.05905. The paper cites arXiv 1801.01290 for this figure, which learns a state value "
    "and keeps its temperature: `--set fixed_temperature=true` keeps ours, and `reward_scale` sets the weight of the "
    "reward against it."
)


class Point(NamedTuple):
    """The deployed returns [seeds, E] at `evaluations` [E] on one task with one TD update (`bootstrap`) and horizon.

    `goals` and `learner` say how the goal of the task changes, and with which temperature and reward scale it was learnt.
    """

    env: str
    bootstrap: bool
    horizon: int
    returns: np.ndarray
    evaluations: np.ndarray
    goals: str
    learner: str

    @property
    def scores(self) -> np.ndarray:
        """The final returns [seeds]: the mean of the last 10 evaluations."""
        return last_mean(self.returns)

    @property
    def steps(self) -> int:
        """The steps trained."""
        return int(self.evaluations[-1])


Arms = dict[tuple[str, bool], list[Point]]
"""The points of each task and update, shortest horizon first; an update that was not run has none."""


def write_figure2(folders: Sequence[Path], out: Path) -> list[Path]:
    """Write figure 2 from run folders of `naive` into `out` and return the files: csv, csv of the curves, md, png.

    Raises:
        ValueError: a folder is no run or one of another method, runs of one point differ in other options, or
            matplotlib is not installed.
    """
    points = _points(read_all(folders))
    rows, curves = [_row(point) for point in points], [row for point in points for row in _curve_rows(point)]
    figure = draw(rows, curves, UPDATES)
    out.mkdir(parents=True, exist_ok=True)
    paths = [out / "figure2.csv", out / "figure2_curves.csv", out / "figure2.md"]
    write(rows, paths[0])
    write(curves, paths[1])
    paths[2].write_text(_markdown(points))
    return [*paths, save(figure, out / "figure2.png")]


def _points(runs: Sequence[Curves]) -> list[Point]:
    """Return a point per task, update and horizon, in order; the lanes of one run may differ in `timeout_bootstrap`."""
    points: dict[tuple[str, bool, int], Point] = {}
    for curves in runs:
        config = curves.config
        if config.algo != "naive":
            raise InputError(f"figure 2 is made of runs of naive, not of {config.algo}")
        returns, horizon = curves.metrics["deployed/return"], config.build_env().train_horizon
        updates = np.resize(np.asarray(config.build_method().sac.timeout_bootstrap, bool), len(returns))
        for update in np.unique(updates).tolist():
            key = (config.env, update, horizon)
            if key in points:
                raise InputError(
                    f"runs on {config.env} with H_T {horizon:,}, {UPDATES[update]}, differ in other options"
                )
            texts = _goals_text(config), _learner_text(config)
            points[key] = Point(*key, returns[updates == update], curves.steps, *texts)
    envs = ordered((env for env, _, _ in points), FIGURE2_TASKS)
    return sorted(points.values(), key=lambda point: (envs.index(point.env), not point.bootstrap, point.horizon))


def _goals_text(config: RunConfig) -> str:
    """Return how the task's goal changes in a run."""
    env = config.build_env()
    protocol = config.protocol(env)
    if len(env.goal_states) == 1:
        return "one goal"
    if protocol.goal_change == protocol.train_horizon:
        return "the target stays between resets"
    drawn = protocol.goal_change or int(config.build_method().phase_length(env, jnp.asarray(TASK)))
    return f"another target every {drawn:,} steps, with and without a reset"


def _learner_text(config: RunConfig) -> str:
    sac = config.build_method().sac
    temperatures, scales = (
        ", ".join(f"{v:g}" for v in np.unique(x)) for x in (sac.initial_temperature, sac.reward_scale)
    )
    kind = "fixed at" if sac.fixed_temperature else "learnt from"
    return f"temperature {kind} {temperatures}, reward scale {scales}"


def _curve_rows(point: Point) -> list[dict[str, Any]]:
    """Return a row per evaluation: the mean over seeds and its interval."""
    scores_at = zip(point.evaluations.tolist(), point.returns.T, strict=True)
    return [{**_key(point), "step": step, **_columns(scores)} for step, scores in scores_at]


def _row(point: Point) -> dict[str, Any]:
    return {**_key(point), "steps": point.steps, "seeds": len(point.scores), **_columns(point.scores)}


def _key(point: Point) -> dict[str, Any]:
    return {"env": point.env, "timeout_bootstrap": point.bootstrap, "train_horizon": point.horizon}


def _columns(scores: np.ndarray) -> dict[str, Any]:
    return dict(zip(("return", "low", "high"), mean_of(scores), strict=True))


def _arms(points: Sequence[Point]) -> Arms:
    envs = dict.fromkeys(point.env for point in points)
    return {
        (env, update): [point for point in points if (point.env, point.bootstrap) == (env, update)]
        for env in envs
        for update in UPDATES
    }


def finding(arm: Sequence[Point]) -> tuple[Estimate, str]:
    """Return the return at the shortest minus that at the longest horizon of one arm, and the word for it."""
    if len(arm) < 2:
        return NO_ESTIMATE, MISSING
    estimate = difference(arm[0].scores, arm[-1].scores)
    return estimate, word_by_sign(estimate, "degrades", "improves", UNCLEAR)


def effect(without: Sequence[Point], biased: Sequence[Point]) -> tuple[int | None, Estimate, str]:
    """Return the longest horizon of both arms, the return with minus without the biased update there, and its word."""
    before, after = ({point.horizon: point.scores for point in arm} for arm in (without, biased))
    common = sorted(before.keys() & after.keys())
    if not common:
        return None, NO_ESTIMATE, MISSING
    estimate = difference(after[common[-1]], before[common[-1]])
    return common[-1], estimate, word_by_sign(estimate, "helps", "hurts", UNCLEAR)


def verdict(finding: str, effect: str, published: str | None) -> str:
    """Return whether a finding and the biased update's `effect` agree with the `published` finding, by `RULES`."""
    if published is None or finding == MISSING:
        return MISSING
    if published == "restored":
        return "differs" if finding == "degrades" else "agrees" if effect == "helps" else INCONCLUSIVE
    return {"degrades": "agrees", "improves": "differs"}.get(finding, INCONCLUSIVE)


def _markdown(points: Sequence[Point]) -> str:
    arms = _arms(points)
    parts = [
        "# Figure 2: return by the steps between resets",
        DESCRIPTION,
        _returns(arms),
        "## Findings",
        _findings(arms),
    ]
    return "\n\n".join([*parts, RULES, _effects(arms), _missing(points), _notes(points)]) + "\n"


def _returns(arms: Arms) -> str:
    horizons = sorted({*FIGURE2_HORIZONS, *(point.horizon for arm in arms.values() for point in arm)})
    lines = []
    for (env, update), arm in arms.items():
        texts = {point.horizon: f"{estimate_text(mean_of(point.scores), 1)} ({len(point.scores)})" for point in arm}
        lines.append([env, UPDATES[update], *(texts.get(horizon, MISSING) for horizon in horizons)])
    return markdown_table(["env", "update", *(f"{horizon:,}" for horizon in horizons)], lines)


def _findings(arms: Arms) -> str:
    lines = []
    for (env, update), arm in arms.items():
        estimate, ours = finding(arm)
        published = FIGURE2_FINDINGS.get((env, update))
        _, _, update_effect = effect(arms[env, True], arms[env, False])
        horizons = f"{arm[0].horizon:,} and {arm[-1].horizon:,}" if len(arm) > 1 else MISSING
        agreement = verdict(ours, update_effect, published)
        lines.append(
            [env, UPDATES[update], horizons, estimate_text(estimate, 1), ours, published or MISSING, agreement]
        )
    header = ["env", "update", "H_T", "shortest minus longest", "finding", "published", "verdict"]
    return markdown_table(header, lines)


def _effects(arms: Arms) -> str:
    lines = []
    for env in dict.fromkeys(env for env, _ in arms):
        horizon, estimate, word = effect(arms[env, True], arms[env, False])
        lines.append([env, f"{horizon:,}" if horizon else MISSING, estimate_text(estimate, 1), word])
    return markdown_table(["env", "H_T", "return with minus without the biased update", "the biased update"], lines)


def _missing(points: Sequence[Point]) -> str:
    present = {(point.env, point.bootstrap, point.horizon) for point in points}
    lines = []
    for env, update in FIGURE2_FINDINGS:
        missing = [f"{horizon:,}" for horizon in FIGURE2_HORIZONS if (env, update, horizon) not in present]
        lines += [f"- {env}, {UPDATES[update]}: {'; '.join(missing)}"] if missing else []
    return "\n".join(["Not run, by H_T:", "", *lines]) if lines else "Every point of the published figure was run."


def _notes(points: Sequence[Point]) -> str:
    trained = dict.fromkeys(f"- {point.env}: {point.steps:,} steps, {point.goals}, {point.learner}" for point in points)
    few = [FEW_SEEDS] if any(len(point.scores) < FEW for point in points) else []
    return "\n\n".join(["Runs:", "\n".join(trained), LEARNER, *few])
