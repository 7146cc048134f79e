"""Five methods on tabletop organization against the paper, at reward scales 1 and 10, ten seeds of each in one program.

    python -m benchmarks.tabletop run vaprl --steps 2500000 --out runs/tabletop
    python -m benchmarks.tabletop report runs/tabletop

`run` goes on where a killed one stopped. `report` writes benchmarks/results/tabletop/: the curves of every seed as csv, the
table as csv, json and md, and the figure.
"""

import argparse
import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from earl_jax import assets
from earl_jax.experiment import RunFolder
from earl_jax.metrics.statistics import bootstrap, iqm
from earl_jax.report.runs import Curves, read
from earl_jax.report.tables import row_of, trailing, write
from earl_jax.training import execute, train

ENV = "tabletop_organization"
SCALES = (1.0, 10.0)
SEEDS = 10
ALGOS = ("naive", "fbrl", "r3l", "vaprl", "oracle")
RESULTS = Path(__file__).parent / "results" / "tabletop"
KEPT = (
    "deployed/success",
    "continuing/reward",
    "continuing/recent",
    "interventions",
    "reached",
    "critic_loss",
    "temperature",
)


def run(algo: str, steps: int, out: Path) -> None:
    """Train ten seeds at each reward scale, as lanes of one program."""
    folder = out / algo
    if folder.exists():
        opened = RunFolder.open(folder).extended(steps)
        execute(opened.experiment, opened, progress=True)
        return
    scales = [scale for scale in SCALES for _ in range(SEEDS)]
    train(
        ENV,
        algo,
        seeds=len(scales),
        steps=steps,
        out=folder,
        checkpoint_every=500_000,
        progress=True,
        reward_scale=scales,
    )


def split(curves: Curves) -> dict[float, Curves]:
    """Return the curves of each reward scale, which are lanes of one run."""
    scales = np.asarray(curves.experiment.options["reward_scale"])
    parts = {}
    for scale in SCALES:
        lanes = scales == scale
        experiment = dataclasses.replace(curves.experiment, options={"reward_scale": scale})
        parts[scale] = Curves(experiment, curves.steps, {name: part[lanes] for name, part in curves.metrics.items()})
    return parts


def cycle(curves: Curves) -> float | None:
    """Return the median over seeds of steps between successes of the task phase in the last quarter of a run."""
    reached = curves.metrics["reached"]
    start = -max(2, reached.shape[1] // 4)
    successes = reached[:, -1] - reached[:, start]
    steps = curves.steps[-1] - curves.steps[start]
    able = successes > 1e-3 * steps
    return float(np.median(steps / successes[able])) if able.any() else None


def summary(algo: str, scale: float, curves: Curves) -> dict[str, Any]:
    """Return a row of the table: ours, and the published figures beside them."""
    found = row_of(curves, last=10, name=algo)
    published: dict[str, str] = {}
    for row in assets.published("crossings"):
        if (row["env"], row["algo"]) == (ENV, algo):
            published = row
    wanted = ("seeds", "steps", "deployed", "deployed_stderr", "deployed_iqm", "deployed_low", "deployed_high")
    return {
        "algo": algo,
        "reward_scale": scale,
        **{name: found[name] for name in wanted},
        "published_last10": published.get("last10"),
        "to_0.5": found["steps_to_0.5"],
        "published_to_0.5": published.get("steps_to_0.5"),
        "to_0.9": found["steps_to_0.9"],
        "published_to_0.9": published.get("steps_to_0.9"),
        "steps_per_reward": found["steps_per_reward"],
        "steps_per_success": cycle(curves),
        "published_steps_per_reward": published.get("steps_per_reward"),
        "continuing": found["continuing"],
        "continuing_stderr": found["continuing_stderr"],
        "published_continuing": found["published_continuing"],
    }


def report(out: Path) -> None:
    """Write tables, curves and figure of every run below `out`."""
    RESULTS.mkdir(parents=True, exist_ok=True)
    runs = {algo: split(read(out / algo)) for algo in ALGOS if (out / algo).exists()}
    rows = [summary(algo, scale, part) for algo, parts in runs.items() for scale, part in parts.items()]
    for algo, parts in runs.items():
        _write_curves(RESULTS / f"{algo}.csv", parts)
    write(rows, RESULTS / "table.csv")
    configs = {algo: json.loads((out / algo / "config.json").read_text()) for algo in runs}
    command = "python -m benchmarks.tabletop run ALGO --steps STEPS --out DIR; python -m benchmarks.tabletop report DIR"
    (RESULTS / "table.json").write_text(
        json.dumps({"command": command, "rows": rows, "runs": configs}, indent=1) + "\n"
    )
    (RESULTS / "table.md").write_text(_markdown(rows))
    _draw(runs).savefig(RESULTS / "curves.png", dpi=130)
    print(_markdown(rows))


def _write_curves(path: Path, parts: dict[float, Curves]) -> None:
    rows = []
    for scale, curves in parts.items():
        for number, step in enumerate(curves.steps.tolist()):
            for lane in range(SEEDS):
                values = {name: f"{curves.metrics[name][lane, number]:.6g}" for name in KEPT}
                rows.append({"reward_scale": scale, "step": step, "seed": lane, **values})
    write(rows, path)


def _markdown(rows: list[dict[str, Any]]) -> str:
    def steps(value: Any) -> str:
        return f"{float(value) / 1e6:.2f}M" if value else "-"

    def rate(value: Any) -> str:
        return f"{float(value):.1f}" if value else "-"

    lines = [
        "| method | scale | seeds | steps | last-10 success [95 % IQM] | published | to 0.5 | publ. | to 0.9 | publ. "
        "| steps/reward | publ. | steps/success |",
        "|" + " --- |" * 13,
    ]
    for row in rows:
        score = f"{row['deployed']:.2f} ({row['deployed_stderr']:.2f}) [{row['deployed_low']:.2f}, {row['deployed_high']:.2f}]"
        cells = [
            row["algo"], f"{row['reward_scale']:g}", row["seeds"], steps(row["steps"]), score, row["published_last10"],
            steps(row["to_0.5"]), steps(row["published_to_0.5"]), steps(row["to_0.9"]), steps(row["published_to_0.9"]),
            rate(row["steps_per_reward"]), rate(row["published_steps_per_reward"]), rate(row["steps_per_success"]),
        ]  # fmt: skip
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return "\n".join(lines) + "\n"


def _draw(runs: dict[str, dict[float, Curves]]) -> Figure:
    """Return deployed and continuing curves of both scales, with the published crossings as marks."""
    figure = Figure(figsize=(12, 7), layout="constrained")
    grid = figure.subplots(2, 2, sharex=True)
    marks = {row["algo"]: row for row in assets.published("crossings") if row["env"] == ENV}
    for row, scale in zip(grid, SCALES, strict=True):
        for number, (algo, parts) in enumerate(runs.items()):
            curves, colour = parts[scale], f"C{number}"
            smooth = trailing(curves.metrics["deployed/success"])
            low, high = np.array([bootstrap(column, iqm) for column in smooth.T]).T
            row[0].plot(curves.steps, smooth.mean(axis=0), color=colour, label=algo)
            row[0].fill_between(curves.steps, low, high, color=colour, alpha=0.15, linewidth=0)
            row[1].plot(curves.steps, curves.metrics["continuing/reward"].mean(axis=0), color=colour)
            for level in ("0.5", "0.9"):
                if marks[algo][f"steps_to_{level}"]:
                    row[0].plot(float(marks[algo][f"steps_to_{level}"]), float(level), "x", color=colour)
        row[0].set(title=f"deployed success (trailing 10), reward scale {scale:g}; x: published crossings", ylim=(0, 1))
        row[1].set(title=f"continuing reward, reward scale {scale:g}")
        row[0].grid(alpha=0.3)
        row[1].grid(alpha=0.3)
    grid[0][0].legend(frameon=False)
    return figure


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    runner = commands.add_parser("run")
    runner.add_argument("algo", choices=ALGOS)
    runner.add_argument("--steps", type=int, default=2_500_000)
    runner.add_argument("--out", type=Path, default=Path("runs/tabletop"))
    commands.add_parser("report").add_argument("out", type=Path)
    arguments = parser.parse_args()
    if arguments.command == "run":
        run(arguments.algo, arguments.steps, arguments.out)
    else:
        report(arguments.out)


if __name__ == "__main__":
    main()
