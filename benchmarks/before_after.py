"""Compare learning before and after a change of the program: `python -m benchmarks.before_after` draws and tabulates two methods.

Before: the runs of tabletop in results/paper (VaPRL and FBRL, ten seeds, bf16). After: those in results/before_after,
trained with the same command by a later commit and cut where the time of the machine ended. Each pair is compared at
the last step that both reached, by a permutation test of the seeds' means over ten evaluations, and by the steps at
which the trailing mean of ten evaluations reaches 0.5. Writes results/before_after/{curves.png,table.csv,table.json}.
"""

import json
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from benchmarks.output import save
from benchmarks.paper_cells import ROOT, TABLETOP, pair
from earl_jax.report.runs import Curves, read
from earl_jax.report.tables import WINDOW, write

AFTER = Path(__file__).parent / "results" / "before_after"
METHODS = ("vaprl", "fbrl")
METRIC = "deployed/success"


def crossing(curves: Curves, level: float = 0.5) -> int | None:
    """Return the first step at which the trailing mean of ten evaluations, averaged over seeds, reaches `level`."""
    trailing = np.convolve(curves.metrics[METRIC].mean(axis=0), np.ones(WINDOW) / WINDOW, mode="valid")
    above = np.flatnonzero(trailing >= level)
    return int(curves.steps[above[0] + WINDOW - 1]) if len(above) else None


def commit(folder: Path) -> str:
    """Return the commit that made the run of `folder`, short."""
    return json.loads((folder / "config.json").read_text())["provenance"]["commit"][:9]


def compare(algo: str, before: Curves, after: Curves) -> dict[str, Any]:
    """Return the row of a method."""
    result = pair("before", "after", {"before": before, "after": after})
    return {
        "algo": algo, "seeds": after.seeds, "steps": result["steps"],
        "before": round(float(result["first_mean"]), 3), "after": round(float(result["second_mean"]), 3),
        "p": round(float(result["p"]), 3), "before_to_0.5": crossing(before), "after_to_0.5": crossing(after),
        "before_commit": commit(ROOT / TABLETOP / algo), "after_commit": commit(AFTER / algo),
    }  # fmt: skip


def draw(axes: Any, algo: str, runs: dict[str, Curves]) -> None:
    """Draw mean and standard error of both runs of a method."""
    for name, curves in runs.items():
        success = curves.metrics[METRIC]
        mean, error = success.mean(axis=0), success.std(axis=0, ddof=1) / np.sqrt(len(success))
        axes.plot(curves.steps, mean, label=name)
        axes.fill_between(curves.steps, mean - error, mean + error, alpha=0.2)
    axes.set(title=f"{algo} on tabletop", xlabel="steps", ylabel="deployed success", ylim=(0, 1.02))
    axes.legend()


def main() -> None:
    """Write the figure and the table."""
    figure, panels = plt.subplots(1, len(METHODS), figsize=(10, 3.6), constrained_layout=True)
    rows = []
    for axes, algo in zip(panels, METHODS, strict=True):
        runs = {"before": read(ROOT / TABLETOP / algo), "after": read(AFTER / algo)}
        rows.append(compare(algo, **runs))
        draw(axes, algo, runs)
    figure.savefig(AFTER / "curves.png", dpi=120)
    write(rows, AFTER / "table.csv")
    save(AFTER / "table.json", "python -m benchmarks.before_after", {"rows": rows})
    print(*rows, sep="\n")


if __name__ == "__main__":
    main()
