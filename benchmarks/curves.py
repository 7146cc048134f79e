"""Learning curves beside the published ones, for the reports of benchmarks.tabletop, sawyer and dense."""

import argparse
import dataclasses
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from earl_jax import assets
from earl_jax.metrics.statistics import bootstrap, iqm
from earl_jax.report.runs import Curves
from earl_jax.report.scores import row_of, trailing
from earl_jax.report.tables import write
from earl_jax.training import resume, train

LEVELS = ("0.5", "0.9")
METRICS = (
    "deployed/success",
    "deployed/return",
    "continuing/reward",
    "continuing/recent",
    "interventions",
    "reached",
    "critic_loss",
    "temperature",
)


def advance(folder: Path, steps: int, *task_and_method: str, **options: Any) -> None:
    """Train to `steps` in `folder`; a killed run is resumed."""
    if folder.exists():
        resume(folder, steps=steps, progress=True)
    else:
        train(*task_and_method, steps=steps, out=folder, checkpoint_every=500_000, progress=True, **options)


def split(curves: Curves, *options: str) -> dict[tuple[float, ...], Curves]:
    """Return the curves of each combination of the values of `options`, in which the lanes of a run differ."""
    lanes, parts = list(zip(*(curves.config.options[option] for option in options), strict=True)), {}
    for values in dict.fromkeys(lanes):
        members = [number for number, lane in enumerate(lanes) if lane == values]
        shared = {**curves.config.options, **dict(zip(options, values, strict=True))}
        metrics = {name: part[members] for name, part in curves.metrics.items()}
        parts[values] = Curves(dataclasses.replace(curves.config, options=shared), curves.steps, metrics)
    return parts


def crossings(env: str, algo: str) -> dict[str, str]:
    """Return the published last-10 success and crossings of a method on a task, or an empty row."""
    return assets.published_row("crossings", env=env, algo=algo)


def summary(curves: Curves, **identity: Any) -> dict[str, Any]:
    """Return a row of the table after the columns of `identity`: our numbers beside the published ones."""
    env, algo = curves.config.env, curves.config.algo
    row, published = row_of(curves, last=10, name=algo), crossings(env, algo)
    columns = ("seeds", "steps", "deployed", "deployed_stderr", "deployed_iqm", "deployed_low", "deployed_high")
    reached = {}
    for level in LEVELS:
        reached[f"to_{level}"] = row[f"steps_to_{level}"]
        reached[f"published_to_{level}"] = published.get(f"steps_to_{level}")
    return {
        **identity,
        **{name: row[name] for name in columns},
        "published_last10": published.get("last10"),
        **reached,
        "continuing": row["continuing"],
        "continuing_stderr": row["continuing_stderr"],
        "published_continuing": row["published_continuing"],
        "steps_per_reward": row["steps_per_reward"],
        "published_steps_per_reward": published.get("steps_per_reward"),
    }


def cells(row: dict[str, Any]) -> dict[str, str]:
    """Return the formatted columns of a row of `summary`, by title."""

    def steps(value: Any) -> str:
        return f"{float(value) / 1e6:.2f}M" if value else "-"

    return {
        "seeds": str(row["seeds"]),
        "steps": steps(row["steps"]),
        "last-10 success [95 % IQM]": f"{row['deployed']:.2f} ({row['deployed_stderr']:.2f}) "
        f"[{row['deployed_low']:.2f}, {row['deployed_high']:.2f}]",
        "published": row["published_last10"] or "-",
        "to 0.5": steps(row["to_0.5"]),
        "publ. 0.5": steps(row["published_to_0.5"]),
        "to 0.9": steps(row["to_0.9"]),
        "publ. 0.9": steps(row["published_to_0.9"]),
    }


def rate(value: Any) -> str:
    """Return formatted steps per reward."""
    return f"{float(value):.1f}" if value else "-"


def markdown(rows: Sequence[dict[str, str]]) -> str:
    """Return a Markdown table of `rows`, which have the same titles."""
    lines = ["| " + " | ".join(rows[0]) + " |", "|" + " --- |" * len(rows[0])]
    return "\n".join([*lines, *("| " + " | ".join(row.values()) + " |" for row in rows)]) + "\n"


def write_curves(path: Path, parts: Sequence[tuple[dict[str, Any], Curves]]) -> None:
    """Write the metrics of every seed of `parts` as csv, after the columns that identify the part."""
    rows = []
    for identity, curves in parts:
        names = [name for name in METRICS if name in curves.metrics]
        for number, step in enumerate(curves.steps.tolist()):
            for lane in range(len(curves.metrics[names[0]])):
                values = {name: f"{curves.metrics[name][lane, number]:.6g}" for name in names}
                rows.append({**identity, "step": step, "seed": lane, **values})
    write(rows, path)


def write_table(folder: Path, rows: list[dict[str, Any]], text: str, command: str, runs: dict[str, Path]) -> None:
    """Write table.csv, table.md and table.json, the last with the command and each run's configuration and versions."""
    configs = {name: json.loads((path / "config.json").read_text()) for name, path in runs.items()}
    write(rows, folder / "table.csv")
    (folder / "table.md").write_text(text)
    (folder / "table.json").write_text(json.dumps({"command": command, "rows": rows, "runs": configs}, indent=1) + "\n")
    print(text)


def draw(axis: Any, curves: Curves, colour: str, label: str, style: str = "-") -> None:
    """Draw deployed success, trailing ten evaluations: the mean, the band of the IQM, and published crossings as marks."""
    smooth = trailing(curves.metrics["deployed/success"])
    low, high = np.array([bootstrap(column, iqm) for column in smooth.T]).T
    axis.plot(curves.steps, smooth.mean(axis=0), style, color=colour, label=label)
    axis.fill_between(curves.steps, low, high, color=colour, alpha=0.15, linewidth=0)
    published = crossings(curves.config.env, curves.config.algo)
    for level in LEVELS:
        if published.get(f"steps_to_{level}"):
            axis.plot(float(published[f"steps_to_{level}"]), float(level), "x", color=colour)


def command_line(
    description: str | None,
    names: Sequence[str],
    steps: int,
    out: Path,
    run: Callable[[str, int, Path], None],
    report: Callable[[Path], None],
) -> None:
    """Execute the command line: `run NAME --steps --out`, or `report DIR`."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    runner = commands.add_parser("run")
    runner.add_argument("name", choices=names)
    runner.add_argument("--steps", type=int, default=steps)
    runner.add_argument("--out", type=Path, default=out)
    commands.add_parser("report").add_argument("out", type=Path)
    arguments = parser.parse_args()
    if arguments.command == "run":
        run(arguments.name, arguments.steps, arguments.out)
    else:
        report(arguments.out)
