"""Franka kitchen, DHand lightbulb and Minitaur pen against the paper: returns, at several reward scales in one program.

    python -m benchmarks.dense run minitaur_oracle --steps 1000000 --out runs/dense
    python -m benchmarks.dense report runs/dense

`run` goes on where a killed one stopped. `report` writes benchmarks/results/dense/: the curves of every seed as csv, the table
as csv, json and md, and the figure.
"""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks.curves import advance, command_line, markdown, split, write_curves, write_table
from earl_jax.metrics.statistics import bootstrap, iqm
from earl_jax.report.runs import Curves, read
from earl_jax.report.tables import row_of, trailing

TASKS = {"kitchen": "franka_kitchen", "dhand": "dhand_lightbulb", "minitaur": "minitaur_pen"}
ALGOS = ("oracle", "naive", "fbrl", "r3l")
NAMES = [f"{task}_{algo}" for task in TASKS for algo in ALGOS]
SCALES = (0.1, 1.0, 10.0)
SEEDS = 4
RESULTS = Path(__file__).parent / "results" / "dense"


def run(name: str, steps: int, out: Path) -> None:
    """Train four seeds at each reward scale, as lanes of one program."""
    task, algo = name.split("_")
    scales = [scale for scale in SCALES for _ in range(SEEDS)]
    advance(out / name, steps, TASKS[task], algo, seeds=len(scales), reward_scale=scales, eval_every=20_000)


def summary(name: str, scale: float, curves: Curves) -> dict[str, Any]:
    """Return a row of the table: where the return began, where it ended, its best, and the published end."""
    found, returns = row_of(curves, 10, name), curves.metrics["deployed/return"]
    return {
        "run": name, "reward_scale": scale, "seeds": found["seeds"], "steps": found["steps"],
        "first_return": float(returns[:, 0].mean()),
        "last10_return": found["deployed"], "stderr": found["deployed_stderr"],
        "iqm_low": found["deployed_low"], "iqm_high": found["deployed_high"],
        "best_trailing_mean": float(trailing(returns.mean(axis=0)).max()),
        "published_return": found["published_deployed"],
        "last10_success": float(curves.metrics["deployed/success"][:, -10:].mean()),
        "continuing": found["continuing"], "published_continuing": found["published_continuing"],
    }  # fmt: skip


def _cells(row: dict[str, Any]) -> dict[str, str]:
    return {
        "run": row["run"],
        "scale": f"{row['reward_scale']:g}",
        "seeds": str(row["seeds"]),
        "steps": f"{row['steps'] / 1e6:.2f}M",
        "first return": f"{row['first_return']:.0f}",
        "last-10 return [95 % IQM]": f"{row['last10_return']:.0f} ({row['stderr']:.0f}) "
        f"[{row['iqm_low']:.0f}, {row['iqm_high']:.0f}]",
        "published end": row["published_return"] or "-",
        "last-10 success": f"{row['last10_success']:.2f}",
        "continuing": f"{row['continuing']:.3f}",
        "publ. continuing": row["published_continuing"] or "-",
    }


def report(out: Path) -> None:
    """Write tables, curves and figure of every run below `out`."""
    RESULTS.mkdir(parents=True, exist_ok=True)
    folders = {name: out / name for name in NAMES if (out / name).exists()}
    runs = {name: split(read(folder), "reward_scale") for name, folder in folders.items()}
    rows = [summary(name, scale, part) for name, parts in runs.items() for scale, part in parts.items()]
    for name, parts in runs.items():
        write_curves(RESULTS / f"{name}.csv", [({"reward_scale": scale}, part) for scale, part in parts.items()])
    command = "python -m benchmarks.dense run RUN --steps STEPS --out DIR; python -m benchmarks.dense report DIR"
    write_table(RESULTS, rows, markdown([_cells(row) for row in rows]), command, folders)
    _figure(runs).savefig(RESULTS / "curves.png", dpi=130)


def _figure(runs: dict[str, dict[float, Curves]]) -> Figure:
    """Return a panel a task: deployed returns by method (line) and reward scale (colour), published ends as thin lines."""
    figure = Figure(figsize=(14, 4.5), layout="constrained")
    styles = dict(zip(ALGOS, ("-", ":", "--", "-."), strict=True))
    for axis, task in zip(figure.subplots(1, len(TASKS)), TASKS, strict=True):
        for name, parts in runs.items():
            if not name.startswith(task):
                continue
            algo = name.split("_")[1]
            for number, (scale, curves) in enumerate(parts.items()):
                smooth = trailing(curves.metrics["deployed/return"])
                low, high = np.array([bootstrap(column, iqm) for column in smooth.T]).T
                label = f"{algo}, scale {scale:g}"
                axis.plot(curves.steps, smooth.mean(axis=0), styles[algo], color=f"C{number}", label=label)
                axis.fill_between(curves.steps, low, high, color=f"C{number}", alpha=0.15, linewidth=0)
            published = row_of(next(iter(parts.values())), 1, name)["published_deployed"]
            axis.axhline(float(published.split()[0]), color="0.4", linewidth=0.8, linestyle=styles[algo])
        axis.set(title=f"{TASKS[task]}: deployed return (trailing 10)", xlabel="environment steps of a seed")
        axis.grid(alpha=0.3)
        axis.legend(frameon=False, fontsize=8)
    return figure


if __name__ == "__main__":
    command_line(__doc__, NAMES, 1_000_000, Path("runs/dense"), run, report)
