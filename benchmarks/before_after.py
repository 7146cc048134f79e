"""Compare learning before and after a change of the program: `python -m benchmarks.before_after`.

Before: the runs of tabletop in results/paper (VaPRL and FBRL, ten seeds, bf16). After: those in results/before_after,
trained with the same command by a later commit and cut where the time of the machine ended. Each pair is tested at the last
step that both have, as `earl-jax compare` does. Writes results/before_after/{curves.png,table.csv,table.json}.
"""

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from benchmarks.output import save
from benchmarks.paper_cells import FORMER_VAPRL, ROOT, TABLETOP, commit_of
from earl_jax.metrics.comparison import mean_interval
from earl_jax.metrics.crossings import crossing
from earl_jax.report.comparison import pair_row, with_verdicts
from earl_jax.report.runs import MethodRuns, read
from earl_jax.report.tables import write
from earl_jax.runs.provenance import short_commit

AFTER = Path(__file__).parent / "results" / "before_after"
METHODS = {"vaprl": f"vaprl/{FORMER_VAPRL}", "fbrl": "fbrl"}
"""The methods, and their runs before."""
METRIC = "deployed/success"


def folders(algo: str) -> dict[str, Path]:
    """Return the run folders of a method before and after."""
    return {"before": ROOT / TABLETOP / METHODS[algo], "after": AFTER / algo}


def compare(algo: str) -> dict[str, Any]:
    """Return the row of a method, without an adjusted p."""
    before, after = (MethodRuns(TABLETOP, algo, f"{algo} {when}", read(path)) for when, path in folders(algo).items())
    row = pair_row(before, after)
    for when, runs in (("before", before), ("after", after)):
        reached = crossing(runs.curves.steps, runs.curves.metrics[METRIC], 0.5)
        row |= {f"{when}_to_0.5": reached.value, f"{when}_to_0.5_low": reached.low, f"{when}_to_0.5_high": reached.high}
        row[f"{when}_commit"] = short_commit(commit_of(folders(algo)[when]))
    return row


def draw(axes: Any, algo: str) -> None:
    """Draw mean and interval of both runs of a method."""
    for when, path in folders(algo).items():
        curves = read(path)
        mean, low, high = mean_interval(curves.metrics[METRIC])
        axes.plot(curves.steps, mean, label=when)
        axes.fill_between(curves.steps, low, high, alpha=0.2, linewidth=0)
    axes.set(title=f"{algo} on tabletop, 10 seeds", xlabel="steps", ylabel="deployed success", ylim=(0, 1.02))
    axes.legend()


def main() -> None:
    """Write the figure and the table."""
    figure, panels = plt.subplots(1, len(METHODS), figsize=(10, 3.6), constrained_layout=True)
    for axes, algo in zip(panels, METHODS, strict=True):
        draw(axes, algo)
    figure.savefig(AFTER / "curves.png", dpi=120)
    rows = with_verdicts([compare(algo) for algo in METHODS])
    write(rows, AFTER / "table.csv")
    save(AFTER / "table.json", "python -m benchmarks.before_after", {"rows": rows})
    print(*rows, sep="\n")


if __name__ == "__main__":
    main()
