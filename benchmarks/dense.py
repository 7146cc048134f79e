"""Compare Franka kitchen, DHand lightbulb and Minitaur pen with the paper: returns, several settings in one program.

    python -m benchmarks.dense run minitaur_oracle --steps 1000000 --out runs/dense
    python -m benchmarks.dense report runs/dense

`run` resumes a killed run; a name that ends in `_ln` normalises the critics' layers. `report` reads every run folder below DIR
whose name begins with a task's, and groups lanes by the options in which they differ. It writes benchmarks/results/dense/: the
curves of every seed as csv, the table as csv, json and md, and the figure.
"""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks.curves import advance, command_line, markdown, split, write_curves, write_table
from earl_jax import assets
from earl_jax.metrics.statistics import bootstrap, iqm
from earl_jax.report.runs import Curves, read
from earl_jax.report.scores import row_of, trailing

TASKS = {"kitchen": "franka_kitchen", "dhand": "dhand_lightbulb", "minitaur": "minitaur_pen"}
ALGOS = ("oracle", "naive", "fbrl", "r3l")
NAMES = [f"{task}_{algo}{norm}" for task in TASKS for algo in ALGOS for norm in ("", "_ln")]
SCALES = {"kitchen": (0.1, 1.0), "dhand": (0.1, 1.0), "minitaur": (0.1,)}
SEEDS = {"kitchen": 3, "dhand": 3, "minitaur": 5}
VARIED = {"reward_scale": "scale", "discount": "discount"}
"""Options in which lanes of a run may differ, and their titles in the table."""
RESULTS = Path(__file__).parent / "results" / "dense"


def run(name: str, steps: int, out: Path) -> None:
    """Train the seeds of a task at each of its reward scales, as lanes of one program."""
    task, algo, *norm = name.split("_")
    scales = [scale for scale in SCALES[task] for _ in range(SEEDS[task])]
    options = {"layer_norm": True} if norm else {}
    advance(out / name, steps, TASKS[task], algo, seeds=len(scales), reward_scale=scales, eval_every=20_000, **options)


def parts(curves: Curves) -> list[tuple[dict[str, float], Curves]]:
    """Return the curves of each setting of a run, with the options that distinguish it."""
    lists = [option for option in VARIED if isinstance(curves.config.options.get(option), list)]
    if not lists:
        return [({}, curves)]
    return [(dict(zip(lists, values, strict=True)), part) for values, part in split(curves, *lists).items()]


def summary(name: str, setting: dict[str, float], curves: Curves) -> dict[str, Any]:
    """Return a row of the table: the first, last and best returns, and the published last return."""
    row, returns = row_of(curves, 10, name), curves.metrics["deployed/return"]
    return {
        "run": name, **{option: curves.config.options.get(option, setting.get(option)) for option in VARIED},
        "layer_norm": bool(curves.config.options.get("layer_norm")),
        "seeds": row["seeds"], "steps": row["steps"],
        "first_return": float(returns[:, 0].mean()),
        "last5_return": float(returns[:, -5:].mean()),
        "last5_best_seed": float(returns[:, -5:].mean(axis=1).max()),
        "best_mean": float(returns.mean(axis=0).max()),
        "published_return": row["published_deployed"],
        "last5_success": float(curves.metrics["deployed/success"][:, -5:].mean()),
        "first_continuing": float(curves.metrics["continuing/recent"][:, 0].mean()),
        "last5_continuing": float(curves.metrics["continuing/recent"][:, -5:].mean()),
    }  # fmt: skip


def _cells(row: dict[str, Any]) -> dict[str, str]:
    varied = {title: "default" if row[option] is None else f"{row[option]:g}" for option, title in VARIED.items()}
    return {
        "run": row["run"],
        **varied,
        "seeds": str(row["seeds"]),
        "steps": f"{row['steps'] / 1e6:.2f}M",
        "first return": f"{row['first_return']:.0f}",
        "last-5 return": f"{row['last5_return']:.0f}",
        "best seed": f"{row['last5_best_seed']:.0f}",
        "published end": row["published_return"] or "-",
        "last-5 success": f"{row['last5_success']:.2f}",
        "reward per step, first and last-5": f"{row['first_continuing']:.2f}, {row['last5_continuing']:.2f}",
    }


def report(out: Path) -> None:
    """Write tables, curves and figure of every run below `out`."""
    RESULTS.mkdir(parents=True, exist_ok=True)
    folders = {path.name: path for path in sorted(out.iterdir()) if path.name.split("_")[0] in TASKS}
    runs = {name: parts(read(folder)) for name, folder in folders.items()}
    rows = [summary(name, setting, part) for name, settings in runs.items() for setting, part in settings]
    for name, settings in runs.items():
        write_curves(RESULTS / f"{name}.csv", settings)
    command = "python -m benchmarks.dense run RUN --steps STEPS --out DIR; python -m benchmarks.dense report DIR"
    write_table(RESULTS, rows, markdown([_cells(row) for row in rows]), command, folders)
    _figure(runs).savefig(RESULTS / "curves.png", dpi=130)


def _draw(axis: Any, name: str, setting: dict[str, float], curves: Curves, colour: str, style: str) -> None:
    smooth = trailing(curves.metrics["deployed/return"])
    text = ", ".join(f"{VARIED[option]} {value:g}" for option, value in setting.items())
    label = " ".join(name.split("_")[1:]) + f" ({text})" * bool(text)
    axis.plot(curves.steps, smooth.mean(axis=0), style, color=colour, label=label)
    if len(smooth) > 2:
        low, high = np.array([bootstrap(column, iqm) for column in smooth.T]).T
        axis.fill_between(curves.steps, low, high, color=colour, alpha=0.15, linewidth=0)


def _figure(runs: dict[str, list[tuple[dict[str, float], Curves]]]) -> Figure:
    """Return a figure with a panel per task: deployed returns of settings with several seeds, and the published oracle."""
    figure = Figure(figsize=(15, 5), layout="constrained")
    for axis, task in zip(figure.subplots(1, len(TASKS)), TASKS, strict=True):
        several = [
            (name, setting, part)
            for name, settings in runs.items()
            for setting, part in settings
            if name.startswith(task) and len(part.metrics["deployed/return"]) > 1
        ]
        for number, line in enumerate(several):
            _draw(axis, *line, colour=f"C{number % 10}", style=("-", "--")[number // 10 % 2])
        published = assets.published_row("table1", env=TASKS[task], algo="oracle")
        axis.axhline(float(published["mean"]), color="0.5", linewidth=0.8, label="published oracle, end")
        axis.set(title=f"{TASKS[task]}: deployed return (trailing 10)", xlabel="environment steps of a seed")
        axis.grid(alpha=0.3)
        axis.locator_params(axis="x", nbins=5)
        axis.legend(frameon=False, fontsize=7)
    return figure


if __name__ == "__main__":
    command_line(__doc__, NAMES, 1_000_000, Path("runs/dense"), run, report)
