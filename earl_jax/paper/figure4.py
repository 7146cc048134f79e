"""Figure 4 of the paper: positions of the gripper, peg or robot during training, by task and method.

Source: Sharma et al. 2022, figure 4 and section 6: where the oracle and FBRL spend their steps. The paper shows a
thresholded map of the difference; the measures and tests of its claims are ours.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from earl_jax.metrics.comparison import LEVEL, Comparison, Sample, holm, welch
from earl_jax.metrics.statistics import Estimate, stderr
from earl_jax.paper.figure4_picture import THRESHOLD_TEXT, draw
from earl_jax.paper.tasks import FIGURE4_GOAL_RADIUS, FIGURE4_LARGER
from earl_jax.paper.visit_maps import VisitMap, checked, write_maps
from earl_jax.report.published import estimate_text
from earl_jax.report.style import save
from earl_jax.report.tables import markdown_table

UNCLEAR, MISSING = "no clear difference", "-"
DESCRIPTION = (
    "Visits to the bins of a square grid during training, mean over seeds (standard error). Distance: mean distance of a "
    "visit to the nearest position of the initial and goal distributions, in the map's unit. Corners: share of visits in "
    "the four corners, squares with a tenth of the map's side. Near goal: share of visits within "
    + ", ".join(f"{radius} m ({env})" for env, radius in FIGURE4_GOAL_RADIUS.items())
    + " of a goal. Covered: share of bins visited. Entropy: of the shares of visits, relative to that of equal visits "
    "everywhere. Concentration: share of visits in the most visited 1 % of bins."
)
CLAIMS = (
    "The paper: the oracle's visits stay around the initial and goal distributions, FBRL's are further away and in the "
    "corners, and the oracle's peg is stuck around the goal box. Each row tests one of these claims over seeds: the "
    "difference with its 95 % interval by Welch's t-test, p, and p corrected by Holm's method for the tests in this table. "
    f"The verdict is `as published` or `opposite to published` if the corrected p is below {LEVEL}, else "
    f"`{UNCLEAR}`. The paper makes no claim about entropy or coverage."
)
POOLED = (
    "These maps are sums over seeds, because earlier versions kept no others. Their measures are those of the sum, their "
    "differences have no test, and the last column gives their sign alone."
)
PICTURE = f"The picture's last column is the oracle's share of visits in a bin minus FBRL's. {THRESHOLD_TEXT}"


class Verdict(NamedTuple):
    """One claim of the paper: the values [seeds] of both methods, and their difference, FBRL minus oracle."""

    env: str
    measure: str
    larger: str
    fbrl: float
    oracle: float
    comparison: Comparison

    @property
    def agrees(self) -> bool:
        """Whether the sign of the difference is the published one."""
        return self.comparison.difference != 0 and (self.comparison.difference > 0) == (self.larger == "fbrl")


def write_figure4(maps: Sequence[VisitMap], out: Path) -> list[Path]:
    """Write figure 4 from `maps` into `out` and return the files: csv of every seed, visits as csv, md, png.

    Raises:
        ValueError: there are no maps, one has a wrong shape, a task and method come twice, or matplotlib is not
            installed.
    """
    maps = checked(maps)
    drawn = draw_figure4(maps, out)
    return [*write_maps(maps, out), *drawn]


def draw_figure4(maps: Sequence[VisitMap], out: Path) -> list[Path]:
    """Write the text and the picture of figure 4 alone, from `maps`, and return both files. Errors as `write_figure4`."""
    maps = checked(maps)
    figure = draw(maps)
    out.mkdir(parents=True, exist_ok=True)
    (out / "figure4.md").write_text(_markdown(maps))
    return [out / "figure4.md", save(figure, out / "figure4.png")]


def _markdown(maps: Sequence[VisitMap]) -> str:
    columns = list(dict.fromkeys(name for part in maps for name in part.scores))
    lines = [_measured(part, columns) for part in maps]
    header = ["env", "algo", "seeds", "steps", *(name.replace("_", " ") for name in columns)]
    parts = ["# Figure 4: positions visited during training", DESCRIPTION, markdown_table(header, lines), CLAIMS]
    parts.append(_verdict_table(verdicts(maps)))
    if any(part.pooled for part in maps):
        parts.append(POOLED)
    missing = [_missing(maps, env) for env in dict.fromkeys(part.env for part in maps)]
    parts += [text for text in missing if text]
    return "\n\n".join([*parts, PICTURE]) + "\n"


def _measured(part: VisitMap, columns: Sequence[str]) -> list[str]:
    """Return the line of one map in the table of measures."""
    texts = []
    for name in columns:
        scores = part.scores.get(name)
        error = "" if scores is None or part.pooled else f" ({stderr(scores):.3f})"
        texts.append(MISSING if scores is None else f"{scores.mean():.3f}{error}")
    seeds = f"{part.seeds}, pooled" if part.pooled else str(part.seeds)
    return [*part.name, seeds, f"{part.steps:,}", *texts]


def verdicts(maps: Sequence[VisitMap]) -> list[Verdict]:
    """Return the comparison of each published claim about a task that has maps of both FBRL and the oracle."""
    scores = {part.name: part.scores for part in maps}
    results = []
    for (env, measure), larger in FIGURE4_LARGER.items():
        fbrl, oracle = (scores.get((env, algo), {}).get(measure) for algo in ("fbrl", "oracle"))
        if fbrl is not None and oracle is not None:
            means = float(fbrl.mean()), float(oracle.mean())
            results.append(Verdict(env, measure, larger, *means, comparison=welch(Sample.of(fbrl), Sample.of(oracle))))
    return results


def _verdict_table(results: Sequence[Verdict]) -> str:
    corrected = holm([verdict.comparison.p for verdict in results])
    header = [
        "env",
        "measure",
        "FBRL",
        "oracle",
        "FBRL minus oracle",
        "p",
        "p (Holm)",
        "larger in the paper",
        "verdict",
    ]
    lines = []
    for verdict, p in zip(results, corrected, strict=True):
        comparison = verdict.comparison
        difference = estimate_text(Estimate(*comparison[:3]), 3)
        texts = [_p_text(comparison.p), _p_text(p), verdict.larger, _word(verdict, p)]
        means = [f"{verdict.fbrl:.3f}", f"{verdict.oracle:.3f}"]
        lines.append([verdict.env, verdict.measure.replace("_", " "), *means, difference, *texts])
    return markdown_table(header, lines)


def _p_text(p: float) -> str:
    return MISSING if math.isnan(p) else f"{p:.2g}"


def _word(verdict: Verdict, p: float) -> str:
    """Return the verdict at the corrected `p`."""
    if verdict.comparison.difference == 0:
        return UNCLEAR
    sign = "as published" if verdict.agrees else "opposite to published"
    if math.isnan(p):
        return f"{sign}, not tested"
    return sign if p < LEVEL else UNCLEAR


def _missing(maps: Sequence[VisitMap], env: str) -> str:
    present = {part.algo for part in maps if part.env == env}
    missing = [algo for algo in ("fbrl", "oracle") if algo not in present]
    return f"No test on {env}: no map of {' or '.join(missing)}." if missing else ""
