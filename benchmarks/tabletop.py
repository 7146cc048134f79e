"""Compare five methods on tabletop organization with the paper, at reward scales 1 and 10, ten seeds each in one program.

    python -m benchmarks.tabletop run vaprl --steps 2500000 --out runs/tabletop
    python -m benchmarks.tabletop report runs/tabletop

`run` resumes a killed run. `report` writes benchmarks/results/tabletop/: the curves of every seed as csv, the
table as csv, json and md, and the figure.
"""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from benchmarks.curves import (
    advance,
    cells,
    command_line,
    draw,
    markdown,
    rate,
    split,
    summary,
    write_curves,
    write_table,
)
from earl_jax.report.runs import Curves, read

ENV = "tabletop_organization"
SCALES = (1.0, 10.0)
SEEDS = 10
ALGOS = ("naive", "fbrl", "r3l", "vaprl", "oracle")
RESULTS = Path(__file__).parent / "results" / "tabletop"


def run(algo: str, steps: int, out: Path) -> None:
    """Train ten seeds at each reward scale, as lanes of one program."""
    scales = [scale for scale in SCALES for _ in range(SEEDS)]
    advance(out / algo, steps, ENV, algo, seeds=len(scales), reward_scale=scales)


def _by_scale(curves: Curves) -> dict[float, Curves]:
    return {scale: part for (scale,), part in split(curves, "reward_scale").items()}


def cycle(curves: Curves) -> float | None:
    """Return the median over seeds of the steps between successes of the task phase in the last quarter of a run."""
    reached = curves.metrics["reached"]
    start = -max(2, reached.shape[1] // 4)
    successes = reached[:, -1] - reached[:, start]
    steps = curves.steps[-1] - curves.steps[start]
    succeeded = successes > 1e-3 * steps
    return float(np.median(steps / successes[succeeded])) if succeeded.any() else None


def report(out: Path) -> None:
    """Write tables, curves and figure of every run below `out`."""
    RESULTS.mkdir(parents=True, exist_ok=True)
    folders = {algo: out / algo for algo in ALGOS if (out / algo).exists()}
    runs = {algo: _by_scale(read(folder)) for algo, folder in folders.items()}
    rows = [
        {**summary(part, algo=algo, reward_scale=scale), "steps_per_success": cycle(part)}
        for algo, parts in runs.items()
        for scale, part in parts.items()
    ]
    for algo, parts in runs.items():
        write_curves(RESULTS / f"{algo}.csv", [({"reward_scale": scale}, part) for scale, part in parts.items()])
    text = markdown(
        [
            {
                "method": row["algo"],
                "scale": f"{row['reward_scale']:g}",
                **cells(row),
                "steps/reward": rate(row["steps_per_reward"]),
                "publ.": rate(row["published_steps_per_reward"]),
                "steps/success": rate(row["steps_per_success"]),
            }
            for row in rows
        ]
    )
    command = "python -m benchmarks.tabletop run ALGO --steps STEPS --out DIR; python -m benchmarks.tabletop report DIR"
    write_table(RESULTS, rows, text, command, folders)
    _figure(runs).savefig(RESULTS / "curves.png", dpi=130)


def _figure(runs: dict[str, dict[float, Curves]]) -> Figure:
    """Return deployed and continuing curves of both scales, with the published crossings as marks."""
    figure = Figure(figsize=(12, 7), layout="constrained")
    grid = figure.subplots(2, 2, sharex=True)
    for row, scale in zip(grid, SCALES, strict=True):
        for number, (algo, parts) in enumerate(runs.items()):
            curves, colour = parts[scale], f"C{number}"
            draw(row[0], curves, colour, algo)
            row[1].plot(curves.steps, curves.metrics["continuing/reward"].mean(axis=0), color=colour)
        row[0].set(title=f"deployed success (trailing 10), reward scale {scale:g}; x: published crossings", ylim=(0, 1))
        row[1].set(title=f"continuing reward, reward scale {scale:g}")
        row[0].grid(alpha=0.3)
        row[1].grid(alpha=0.3)
    grid[0][0].legend(frameon=False)
    return figure


if __name__ == "__main__":
    command_line(__doc__, ALGOS, 2_500_000, Path("runs/tabletop"), run, report)
