"""TD3 beside SAC as the learner of oracle RL on tabletop: `python -m benchmarks.paper.learners`.

Reads the runs of results/learners and writes results/learners/curves.png and the table `td3` of the pages. A row is the
score of a run, with its interval over seeds and the permutation test.
"""

from pathlib import Path

from benchmarks.output import RESULTS, pages_with, shrink, write_files
from earl_jax.metrics.comparison import permutation
from earl_jax.report.plots import plot_runs
from earl_jax.report.runs import read
from earl_jax.report.scores import interval_of, seed_scores
from earl_jax.report.tables import interval_text, markdown_table, millions

RUNS = RESULTS / "learners"
NAMES = ("sac", "td3")


def table() -> str:
    """Return the table of both learners."""
    curves = [read(RUNS / name) for name in NAMES]
    scores = [seed_scores(run) for run in curves]
    lines = []
    for name, run, own in zip(NAMES, curves, scores, strict=True):
        test = ["-", "-"]
        if name != "sac":
            difference, low, high, p = permutation(own, scores[0])
            test = [interval_text(difference, low, high), f"{p:.2g}"]
        lines.append([name, len(own), millions(run.steps[-1]), interval_text(*interval_of(run, own)), *test])
    return markdown_table(("learner", "seeds", "steps", "success [95 %]", "difference to SAC [95 %]", "p"), lines)


def files() -> dict[Path, str]:
    """Return the page with the table."""
    return pages_with({"td3": table()})


def draw() -> None:
    """Write the curves of both learners."""
    names = [name.upper() for name in NAMES]
    shrink(plot_runs([RUNS / name for name in NAMES], RUNS / "curves.png", smooth=3, names=names))


if __name__ == "__main__":
    write_files(files())
    draw()
