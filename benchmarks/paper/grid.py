"""The grid of tasks by methods: the table of our scores above the published ones, and the picture of all curves."""

import textwrap
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from benchmarks.output import shrink
from earl_jax.envs import PAPER_TASKS, make
from earl_jax.metrics.comparison import CANNOT_TELL
from earl_jax.paper.artefact import METHODS, methods_on
from earl_jax.report.plots import RELEASED, draw_curves
from earl_jax.report.published import RECONSTRUCTED, published_beside, released_beside, share_text, training_steps
from earl_jax.report.runs import Curves
from earl_jax.report.scores import SMOOTH, in_as_many_steps
from earl_jax.report.style import AXES, legend_below, matplotlib, method_title, new_figure, save, step_axis, task_title
from earl_jax.report.tables import Row, markdown_table

WORDS = {"above": "▲ above", "below": "▼ below", CANNOT_TELL: "?"}
WHOLE = 0.95
"""Share of its steps from which on a run counts as whole."""
LEGEND = (
    "A cell has our score, the published one over the same steps, and the verdict of a test over seeds (permutation; for the "
    "Minitaur Welch's; p adjusted over the methods of a task): ▲ above, ▼ below, or ? where the seeds cannot tell. A cell "
    f"with less than {100 * WHOLE:.0f} % of its steps shows its share. The first three tasks are scored by success, the "
    "others by return. No runs of the Minitaur were released, so its cells show the printed score, of the last evaluation. The "
    "lightbulb is our reconstruction and is not compared."
)
OURS = {"color": "#0072B2"}
PRINTED = {**RELEASED, "marker": "D", "linestyle": "", "markersize": 4}


def text(rows: Sequence[Row]) -> str:
    """Return the table of the `cells.cells`, a line for each task, and its legend."""
    cells = {(row["env"], row["algo"]): row for row in rows}
    lines = [
        [task_title(env), *(_cell(cells[env, algo]) if (env, algo) in cells else "" for algo in METHODS)]
        for env in PAPER_TASKS
    ]
    return f"{markdown_table(['', *map(method_title, METHODS)], lines)}\n\n{textwrap.fill(LEGEND, 100)}"


def summary(rows: Sequence[Row]) -> str:
    """Return what the tests of whole `cells.cells` say, in three sentences."""
    run = [row for row in rows if row["seeds"]]
    whole = [row for row in run if _is_whole(row)]
    open_ones = [row for row in whole if row["verdict"] == CANNOT_TELL]
    told = [row for row in whole if row["verdict"] in ("above", "below")]
    shares = [row["steps"] / row["of"] for row in run if not _is_whole(row)]
    differing = (
        f"{method_title(row['algo'])} is {row['verdict']} the paper on {task_title(row['env'])} ({_p_text(row['p_holm'])})"
        for row in told
    )
    sentences = (
        f"Of the {len(rows)} cells of the paper's table 1, {len(whole)} have run for {100 * WHOLE:.0f} % of its steps or more.",
        f"In {len(open_ones)} of these we detect no difference from the paper (p = "
        f"{min(row['p_holm'] for row in open_ones):.2g} or more, adjusted over the methods of a task). Where "
        f"seeds differ, they would detect only differences of {_listed(_detectable(open_ones))}, depending on the cell. "
        "With the adjustment they would detect only larger ones.",
        f"Of the others, {_listed(differing)}." if told else "No other differs.",
        f"The other cells have run for {100 * min(shares):.0f} to {100 * max(shares):.0f} % of their steps.",
    )
    return textwrap.fill(" ".join(sentences), 100)


def _listed(parts: Iterable[str]) -> str:
    *others, last = parts
    return f"{', '.join(others)} and {last}" if others else last


def _p_text(p: float) -> str:
    return f"p = {p:.2g}" if p >= 0.001 else "p < 0.001"


def _detectable(rows: Sequence[Row]) -> Iterator[str]:
    for sparse, score, style in ((True, "success", ".2g"), (False, "return", ".0f")):
        found = [row["detectable"] for row in rows if row["detectable"] > 0 and make(row["env"]).sparse == sparse]
        if found:
            yield f"{min(found):{style}} to {max(found):{style}} in {score}"


def _is_whole(row: Row) -> bool:
    return row["steps"] >= WHOLE * row["of"]


def _cell(row: Row) -> str:
    return "not run" if row["seeds"] is None else "<br>".join(_parts(row))


def _parts(row: Row) -> Iterator[str]:
    style = ".2f" if make(row["env"]).sparse else ",.0f"
    share = "" if _is_whole(row) else f" at {share_text(row['steps'], row['of'])}"
    yield f"**{row['mean']:{style}}**"
    if row["env"] in RECONSTRUCTED:
        yield f"not compared{share}"
    elif row["verdict"] in WORDS:
        yield format(row["other_mean"], style)
        yield f"{WORDS[row['verdict']]}{share}"
    else:
        yield format(float(row["printed"].split()[0]), style)
        yield f"not compared{share}"


def draw(runs: Sequence[Curves], path: Path) -> None:
    """Draw the deployed scores of all cells, a row for each task: seeds thin, means, and the published ones in grey.

    Where nothing was released, a diamond is the printed score.
    """
    cells = {(curves.env, curves.algo): curves for curves in runs}
    with matplotlib().rc_context({"font.size": 8}):
        figure, axes = new_figure(len(PAPER_TASKS), len(METHODS), (7.8, 8.6), sharex="row", sharey="row")
        for env, line in zip(PAPER_TASKS, axes, strict=True):
            for algo, axis in zip(METHODS, line, strict=True):
                if algo in methods_on(env):
                    _draw_cell(axis, cells.get((env, algo)))
                else:
                    axis.set_axis_off()
            metric = next(curves.deployed_metric for curves in runs if curves.env == env)
            line[0].set_ylabel(f"{task_title(env)}\n{AXES[metric].split()[0]}")
            line[0].set_xlim(0, training_steps(env))
        for algo, axis in zip(METHODS, axes[0], strict=True):
            axis.set_title(method_title(algo))
        step_axis(axes[-1, len(METHODS) // 2])
        _add_legend(figure)
        shrink(save(figure, path))


def _draw_cell(axis: Any, curves: Curves | None) -> None:
    if curves:
        metric = curves.deployed_metric
        if released := released_beside(curves):
            draw_curves(axis, released, metric, in_as_many_steps(SMOOTH, curves, released), RELEASED, each=True)
        elif printed := published_beside(1, curves):
            axis.plot(training_steps(curves.env), printed.value, **PRINTED, clip_on=False)
        draw_curves(axis, curves, metric, SMOOTH, OURS, each=True)
    step_axis(axis)
    axis.set_xlabel("")
    axis.grid(alpha=0.3)


def _add_legend(figure: Any) -> None:
    mean, seed = {"linewidth": 1.4}, {"linewidth": 0.8, "alpha": 0.4}
    entries = {
        "Ours, mean over seeds": {**OURS, **mean},
        "Ours, each seed": {**OURS, **seed},
        "Published, mean": {**RELEASED, **mean},
        "Published, each of five seeds": {**RELEASED, **seed},
        "Published, printed score": PRINTED,
    }
    legend_below(figure, entries, 3)
