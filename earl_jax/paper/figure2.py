"""Figure 2 of the paper: the final return of plain SAC by the number of steps between resets, with two TD updates.

Source: Sharma et al. 2022, figure 2. The biased update takes every time-out for a terminal state.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from earl_jax.metrics.statistics import Estimate, difference, mean_of
from earl_jax.paper.verdicts import FEW, FEW_SEEDS, bracketed, told
from earl_jax.report.runs import Curves, read_all
from earl_jax.report.style import TITLES, canvas, ordered, save, title
from earl_jax.report.tables import WINDOW, grid, write

HORIZONS = (1_000, 2_000, 5_000, 10_000, 20_000, 100_000, 200_000)
"""H_T of the published figure."""
ARMS = {True: "without the biased update", False: "with the biased update"}
"""By `timeout_bootstrap`."""
LOOK = {True: ("#D55E00", "o-"), False: ("#0072B2", "s--")}
PUBLISHED = {
    ("cheetah_run", True): "degrades",
    ("cheetah_run", False): "restored",
    ("fish_swim", True): "degrades",
    ("fish_swim", False): "degrades",
}
"""The paper's finding as H_T grows."""
UNKNOWN = "no difference told"
TEXT = (
    "Final deployed return (mean of a seed's last 10 evaluations) of naive RL by H_T, the steps between resets: mean over seeds "
    "[95 % bootstrap interval] (seeds), `-` where nothing was run."
)
FINDING = (
    "Finding: return at the shortest minus at the longest H_T; `degrades` where its 95 % interval lies above 0, `improves` "
    "where below, else `no difference told`. Verdict: `agrees` with a published `degrades` where ours is the same; with "
    "`restored` where ours does not degrade and the biased update helps at the longest H_T (second table); `differs` where "
    "ours is the opposite; else `not told`."
)


class Bar(NamedTuple):
    """The final returns [seeds] of one task, arm (`timeout_bootstrap`) and horizon, after `steps` steps."""

    env: str
    bootstrap: bool
    horizon: int
    scores: np.ndarray
    steps: int


def write_figure2(folders: Sequence[Path], out: Path) -> list[Path]:
    """Write figure 2 from run folders of `naive` into `out` and return the files: csv, md, png.

    Raises:
        ValueError: a folder is no run or one of another method, runs of one point differ in other options, or matplotlib
            is not installed.
    """
    bars = _bars(read_all(folders))
    picture = _draw(bars)
    out.mkdir(parents=True, exist_ok=True)
    write([_row(bar) for bar in bars], out / "figure2.csv")
    (out / "figure2.md").write_text(_markdown(bars))
    return [out / "figure2.csv", out / "figure2.md", save(picture, out / "figure2.png")]


def _bars(runs: Sequence[Curves]) -> list[Bar]:
    """Return a `Bar` a task, arm and horizon, in order; the lanes of one run may differ in `timeout_bootstrap`."""
    bars: dict[tuple[str, bool, int], Bar] = {}
    for curves in runs:
        one = curves.config
        if one.algo != "naive":
            raise ValueError(f"figure 2 is made of runs of naive, not of {one.algo}")
        scores = curves.metrics["deployed/return"][:, -WINDOW:].mean(axis=1)
        arms = np.resize(np.asarray(one.build_method().sac.timeout_bootstrap, bool), len(scores))
        for arm in np.unique(arms).tolist():
            key = (one.env, arm, one.build_env().train_horizon)
            if key in bars:
                raise ValueError(f"runs on {one.env} with H_T {key[2]:,}, {ARMS[arm]}, differ in other options")
            bars[key] = Bar(*key, scores[arms == arm], int(curves.steps[-1]))
    envs = ordered((env for env, _, _ in bars), TITLES)
    return sorted(bars.values(), key=lambda bar: (envs.index(bar.env), not bar.bootstrap, bar.horizon))


def _row(bar: Bar) -> dict[str, Any]:
    estimate = mean_of(bar.scores)
    return {
        "env": bar.env,
        "timeout_bootstrap": bar.bootstrap,
        "train_horizon": bar.horizon,
        "steps": bar.steps,
        "seeds": len(bar.scores),
        "return": estimate.value,
        "low": estimate.low,
        "high": estimate.high,
    }


def _arms(bars: Sequence[Bar]) -> dict[tuple[str, bool], list[Bar]]:
    """Return the bars of each task and arm, shortest horizon first; an arm that nobody ran has none."""
    envs = dict.fromkeys(bar.env for bar in bars)
    return {(env, arm): [bar for bar in bars if (bar.env, bar.bootstrap) == (env, arm)] for env in envs for arm in ARMS}


def finding(arm: Sequence[Bar]) -> tuple[Estimate, str]:
    """Return the return at the shortest minus at the longest horizon of one arm, and what it says."""
    if len(arm) < 2:
        return Estimate(math.nan, math.nan, math.nan), "-"
    estimate = difference(arm[0].scores, arm[-1].scores)
    return estimate, told(estimate, "degrades", "improves", UNKNOWN)


def effect(without: Sequence[Bar], biased: Sequence[Bar]) -> tuple[int | None, Estimate, str]:
    """Return the longest horizon of both arms, the return with minus without the biased update there, and what it says."""
    before, after = ({bar.horizon: bar.scores for bar in arm} for arm in (without, biased))
    both = sorted(before.keys() & after.keys())
    if not both:
        return None, Estimate(math.nan, math.nan, math.nan), "-"
    estimate = difference(after[both[-1]], before[both[-1]])
    return both[-1], estimate, told(estimate, "helps", "hurts", UNKNOWN)


def verdict(found: str, effect: str, published: str | None) -> str:
    """Return how a finding and the biased update's `effect` agree with the `published` finding, as `FINDING` says."""
    if published is None or found == "-":
        return "-"
    if published == "restored":
        return "differs" if found == "degrades" else "agrees" if effect == "helps" else "not told"
    return {"degrades": "agrees", "improves": "differs"}.get(found, "not told")


def _markdown(bars: Sequence[Bar]) -> str:
    arms = _arms(bars)
    horizons = sorted({*HORIZONS, *(bar.horizon for bar in bars)})
    lines, findings = [], []
    for (env, arm), part in arms.items():
        known = {bar.horizon: f"{bracketed(mean_of(bar.scores), 1)} ({len(bar.scores)})" for bar in part}
        lines.append([env, ARMS[arm], *(known.get(horizon, "-") for horizon in horizons)])
        estimate, found = finding(part)
        theirs = PUBLISHED.get((env, arm))
        ends = f"{part[0].horizon:,} and {part[-1].horizon:,}" if len(part) > 1 else "-"
        findings.append(
            [
                env,
                ARMS[arm],
                ends,
                bracketed(estimate, 1),
                found,
                theirs or "-",
                verdict(found, effect(arms[env, True], arms[env, False])[2], theirs),
            ]
        )
    header = ["env", "update", *(f"{horizon:,}" for horizon in horizons)]
    titles = ["env", "update", "H_T", "shortest minus longest", "finding", "published", "verdict"]
    parts = [
        "# Figure 2: return by the steps between resets",
        TEXT,
        grid(header, lines),
        "## Findings",
        grid(titles, findings),
    ]
    parts += [FINDING, _effects(arms), _missing(bars), _notes(bars)]
    return "\n\n".join(parts) + "\n"


def _effects(arms: dict[tuple[str, bool], list[Bar]]) -> str:
    lines = []
    for env in dict.fromkeys(env for env, _ in arms):
        horizon, estimate, word = effect(arms[env, True], arms[env, False])
        lines.append([env, f"{horizon:,}" if horizon else "-", bracketed(estimate, 1), word])
    return grid(["env", "H_T", "return with minus without the biased update", "the biased update"], lines)


def _missing(bars: Sequence[Bar]) -> str:
    had = {(bar.env, bar.bootstrap, bar.horizon) for bar in bars}
    lines = []
    for env, arm in PUBLISHED:
        absent = [f"{horizon:,}" for horizon in HORIZONS if (env, arm, horizon) not in had]
        lines += [f"- {env}, {ARMS[arm]}: {'; '.join(absent)}"] if absent else []
    return "\n".join(["Not run, by H_T:", "", *lines]) if lines else "Every point of the published figure was run."


def _notes(bars: Sequence[Bar]) -> str:
    lived = dict.fromkeys(f"{bar.env} {bar.steps:,}" for bar in bars)
    few = f" {FEW_SEEDS}" if any(len(bar.scores) < FEW for bar in bars) else ""
    return f"Steps lived: {', '.join(lived)}.{few}"


def _draw(bars: Sequence[Bar]) -> Any:
    """Return a figure with a panel a task and a line an arm."""
    envs = list(dict.fromkeys(bar.env for bar in bars))
    figure, axes = canvas(1, len(envs), (max(5.0 * len(envs), 6.0), 4.2))
    for (env, arm), part in _arms(bars).items():
        axis, (colour, style) = axes[0, envs.index(env)], LOOK[arm]
        estimates = [mean_of(bar.scores) for bar in part]
        reach = [[max(one.value - one.low, 0), max(one.high - one.value, 0)] for one in estimates]
        places = [bar.horizon * (1.03 if arm else 0.97) for bar in part]
        values, label = [one.value for one in estimates], ARMS[arm]
        spread = np.array(reach).reshape(-1, 2).T
        axis.errorbar(places, values, spread, fmt=style, color=colour, label=label, capsize=3, markersize=5)
    for env, axis in zip(envs, axes[0], strict=True):
        axis.set(title=title(env), xscale="log", xlabel="H_T, steps between resets", ylabel="final return")
        horizons = sorted({bar.horizon for bar in bars if bar.env == env})
        axis.set_xticks(horizons, [_short(horizon) for horizon in horizons])
        axis.set_xticks([], minor=True)
        axis.grid(alpha=0.3)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False)
    return figure


def _short(horizon: int) -> str:
    return f"{horizon // 1000}k" if horizon % 1000 == 0 else f"{horizon:,}"
