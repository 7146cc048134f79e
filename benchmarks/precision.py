"""Compare learning in bf16 and tf32: `python -m benchmarks.precision` draws and tabulates the runs in results/precision.

    earl-jax train tabletop_organization --algo vaprl --seeds 10 --steps 2500000 --eval-every 20000 [--set precision=bf16]

made the runs, in parallel on one H200 for 400 seconds, where both stopped. They are compared with the ten lanes of reward scale
10 in results/tabletop, trained with the same method at an earlier commit in tf32.
"""

import csv
import json
from collections import defaultdict
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from benchmarks.output import save
from earl_jax.report.tables import write

RESULTS = Path("benchmarks/results")
METRIC = "deployed/success"
EVERY = 20_000
LAST = 5
"""Evaluations averaged at the step that both runs reached."""


def curve(path: Path, seeds: int = 10) -> tuple[np.ndarray, np.ndarray]:
    """Return steps [E], every `EVERY`, and success [N, E] of the seeds of a metrics file, those of reward scale 10."""
    table: dict[int, dict[int, float]] = defaultdict(dict)
    with path.open() as handle:
        for row in csv.DictReader(handle):
            if float(row.get("reward_scale", 10.0)) == 10.0 and int(row["step"]) % EVERY == 0:
                table[int(row["step"])][int(row["seed"])] = float(row[METRIC])
    steps = sorted(step for step, row in table.items() if len(row) == seeds)
    return np.array(steps), np.array([[table[step][seed] for step in steps] for seed in range(seeds)])


def crossing(steps: np.ndarray, mean: np.ndarray, level: float) -> int | None:
    """Return the first step at which the mean of the trailing `LAST` evaluations reaches `level`."""
    trailing = np.convolve(mean, np.ones(LAST) / LAST, mode="valid")
    above = np.flatnonzero(trailing >= level)
    return int(steps[above[0] + LAST - 1]) if len(above) else None


def main() -> None:
    curves = {
        "tf32": curve(RESULTS / "precision/vaprl_tf32.csv"),
        "bf16": curve(RESULTS / "precision/vaprl_bf16.csv"),
        "tf32, earlier commit": curve(RESULTS / "tabletop/vaprl.csv"),
    }
    until, rows = min(steps[-1] for steps, _ in curves.values()), []
    figure, axes = plt.subplots(figsize=(6, 4))
    for name, (steps, success) in curves.items():
        mean, error = success.mean(axis=0), success.std(axis=0, ddof=1) / np.sqrt(len(success))
        drawn = steps <= 700_000
        axes.plot(steps[drawn], mean[drawn], label=name)
        axes.fill_between(steps[drawn], (mean - error)[drawn], (mean + error)[drawn], alpha=0.2)
        last = success[:, steps <= until][:, -LAST:].mean(axis=1)
        rows.append({
            "precision": name, "seeds": len(success), "at_step": int(until), f"success_last_{LAST}": round(float(last.mean()), 3),
            "stderr": round(float(last.std(ddof=1) / np.sqrt(len(last))), 3), "to_0.25": crossing(steps, mean, 0.25),
            "to_0.5": crossing(steps, mean, 0.5), "trained_to": int(steps[-1]),
        })  # fmt: skip
    axes.set(xlabel="steps", ylabel="deployed success", title="VaPRL on tabletop, ten seeds, mean and standard error")
    axes.legend()
    figure.savefig(RESULTS / "precision/curves.png", dpi=120, bbox_inches="tight")
    write(rows, RESULTS / "precision/table.csv")
    save(RESULTS / "precision/table.json", "python -m benchmarks.precision", {"rows": rows})
    print(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
