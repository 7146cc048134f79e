"""Franka kitchen, DHand lightbulb and Minitaur pen against the paper: returns, at several reward scales in one program.

    python -m benchmarks.dense run minitaur_oracle --steps 1000000 --out runs/dense
    python -m benchmarks.dense report runs/dense

`run` goes on where a killed one stopped; a name that ends in `_ln` normalises the critics' layers. `report` writes
benchmarks/results/dense/: the curves of every seed as csv, the table as csv, json and md, and the figure.
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
NAMES = [f"{task}_{algo}{norm}" for task in TASKS for algo in ALGOS for norm in ("", "_ln")]
SCALES = {"kitchen": (0.1, 1.0), "dhand": (0.1, 1.0), "minitaur": (0.1,)}
SEEDS = {"kitchen": 3, "dhand": 3, "minitaur": 5}
RESULTS = Path(__file__).parent / "results" / "dense"


def run(name: str, steps: int, out: Path) -> None:
    """Train the seeds of a task at each of its reward scales, as lanes of one program."""
    task, algo, *norm = name.split("_")
    scales = [scale for scale in SCALES[task] for _ in range(SEEDS[task])]
    options = {"layer_norm": True} if norm else {}
    advance(out / name, steps, TASKS[task], algo, seeds=len(scales), reward_scale=scales, eval_every=20_000, **options)


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
    """Return a panel a task: deployed returns by run (colour) and method (line), published ends as thin lines."""
    figure = Figure(figsize=(14, 4.5), layout="constrained")
    styles = dict(zip(ALGOS, ("-", ":", "--", "-."), strict=True))
    for axis, task in zip(figure.subplots(1, len(TASKS)), TASKS, strict=True):
        number = 0
        for name, parts in runs.items():
            if not name.startswith(task):
                continue
            _, algo, *norm = name.split("_")
            for scale, curves in parts.items():
                smooth = trailing(curves.metrics["deployed/return"])
                low, high = np.array([bootstrap(column, iqm) for column in smooth.T]).T
                label, colour = f"{algo}, scale {scale:g}" + ", layer norm" * len(norm), f"C{number}"
                axis.plot(curves.steps, smooth.mean(axis=0), styles[algo], color=colour, label=label)
                axis.fill_between(curves.steps, low, high, color=colour, alpha=0.15, linewidth=0)
                number += 1
            published = row_of(next(iter(parts.values())), 1, name)["published_deployed"]
            axis.axhline(float(published.split()[0]), color="0.4", linewidth=0.8, linestyle=styles[algo])
        axis.set(title=f"{TASKS[task]}: deployed return (trailing 10)", xlabel="environment steps of a seed")
        axis.grid(alpha=0.3)
        axis.legend(frameon=False, fontsize=8)
    return figure


if __name__ == "__main__":
    command_line(__doc__, NAMES, 1_000_000, Path("runs/dense"), run, report)
