"""Compare Sawyer door and peg with the paper: the oracle on both, FBRL and VaPRL on the door, with and without layer norm.

    python -m benchmarks.sawyer run door_fbrl --steps 2000000 --out runs/sawyer
    python -m benchmarks.sawyer report runs/sawyer

`run` resumes a killed run; a name that ends in `_ln` normalises the critics' layers. `report` writes
benchmarks/results/sawyer/: the curves of every seed as csv, the table as csv, json and md, and the figure.
"""

from pathlib import Path

from matplotlib.figure import Figure

from benchmarks.curves import advance, cells, command_line, draw, markdown, rate, summary, write_curves, write_table
from earl_jax.report.runs import Curves, read

SEEDS = 5
NAMES = [
    f"{task}_{algo}{norm}"
    for task, algos in {"door": ("oracle", "fbrl", "vaprl"), "peg": ("oracle",)}.items()
    for algo in algos
    for norm in ("", "_ln")
]
RESULTS = Path(__file__).parent / "results" / "sawyer"


def run(name: str, steps: int, out: Path) -> None:
    """Train five seeds of one run, as lanes of one program."""
    task, algo, *norm = name.split("_")
    options = {"layer_norm": True} if norm else {}
    advance(out / name, steps, f"sawyer_{task}", algo, seeds=SEEDS, **options)


def report(out: Path) -> None:
    """Write tables, curves and figure of every run below `out`."""
    RESULTS.mkdir(parents=True, exist_ok=True)
    folders = {name: out / name for name in NAMES if (out / name).exists()}
    runs = {name: read(folder) for name, folder in folders.items()}
    rows = [
        summary(curves, run=name, layer_norm=bool(curves.config.options.get("layer_norm")))
        for name, curves in runs.items()
    ]
    for name, curves in runs.items():
        write_curves(RESULTS / f"{name}.csv", [({}, curves)])
    text = markdown(
        [
            {
                "run": row["run"],
                **cells(row),
                "continuing": f"{row['continuing']:.4f}",
                "publ.": row["published_continuing"] or "-",
                "steps/reward": rate(row["steps_per_reward"]),
            }
            for row in rows
        ]
    )
    command = "python -m benchmarks.sawyer run RUN --steps STEPS --out DIR; python -m benchmarks.sawyer report DIR"
    write_table(RESULTS, rows, text, command, folders)
    _figure(runs).savefig(RESULTS / "curves.png", dpi=130)


def _figure(runs: dict[str, Curves]) -> Figure:
    figure = Figure(figsize=(12, 4.5), layout="constrained")
    for axis, task in zip(figure.subplots(1, 2), ("door", "peg"), strict=True):
        task_runs = {name: curves for name, curves in runs.items() if name.startswith(task)}
        colours = {algo: f"C{number}" for number, algo in enumerate(("oracle", "fbrl", "vaprl"))}
        for name, curves in task_runs.items():
            algo = curves.config.algo
            norm = name.endswith("_ln")
            draw(axis, curves, colours[algo], algo + ", layer norm" * norm, "--" if norm else "-")
        axis.set(title=f"sawyer {task}: deployed success (trailing 10); x: published crossings", ylim=(0, 1.02))
        axis.set(xlabel="environment steps of a seed", xlim=(0, None))
        axis.grid(alpha=0.3)
        axis.legend(frameon=False)
    return figure


if __name__ == "__main__":
    command_line(__doc__, NAMES, 2_000_000, Path("runs/sawyer"), run, report)
