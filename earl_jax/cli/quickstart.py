"""The command `quickstart` (also `make quickstart`), which trains a small preset on a laptop's CPU."""

import time
from pathlib import Path

from earl_jax.options.presets import preset

ENV, ALGO = "tabletop_organization", "fbrl"
RANGE = ("0.30", "0.80")
"""The worst and the best score of two seeds, rounded outwards: pairs of five seeds on one machine, for any end from
160,000 steps on, and two seeds on another machine (0.39 to 0.76); docs/results.md lists the numbers."""
EXPECTED = """\
Expect a score of {low} to {high} after two to seven minutes on two free CPU
cores. The result depends on the machine, because its rounding decides which of many courses two seeds take.
"""

CHANGES = """\
Forward-backward RL on tabletop organization, without resets: the paper's task, sparse reward, phases and evaluation.
A small preset, not the paper's: {steps:,} steps instead of 2.5M, {seeds} seeds, networks of 64-64 instead of 256-256, batch 64
instead of 256, learning rate 1e-3 instead of 3e-4, bootstrapping through time-outs, half of each batch from the
demonstrations, layer norm in the critics, an evaluation of {eval_episodes} episodes every {eval_every:,} steps \
instead of 10 every 10,000.
"""


def quickstart(out: Path = Path("runs/quickstart"), steps: int | None = None, overwrite: bool = False) -> None:
    """Train forward-backward RL on tabletop organization on a CPU within minutes, and draw its curves.

    Args:
        out: New folder for the run, curves.png and table.md.
        steps: Training steps of each seed. By default 170,000.
        overwrite: Replace an earlier run in that folder.
    """
    from earl_jax.report.plots import plot_runs
    from earl_jax.report.scores import SMOOTH
    from earl_jax.report.tables import run_table, tabulate, write
    from earl_jax.training import train

    began = time.perf_counter()
    values = preset("quick")
    length, every = values["steps"], values["eval_every"]
    steps = length if steps is None else steps
    values |= {"steps": steps, "eval_every": every if steps % every == 0 else steps, "checkpoint_every": steps}
    print(CHANGES.format(**values))
    if steps == length:
        print(EXPECTED.format(low=RANGE[0], high=RANGE[1]))
    run = out / ALGO
    result = train(ENV, ALGO, out=run, overwrite=overwrite, progress=True, **values)
    figure = plot_runs([run], out / "curves.png", smooth=SMOOTH)
    table = out / "table.md"
    rows = tabulate([run])
    write(rows, table)
    print(f"\n{run_table(rows).text()}\n\n{result.score()}")
    print(f"figure: {figure}   (a point is the mean of {SMOOTH} evaluations)")
    print(f"table:  {table}\nrun:    {run}   ({time.perf_counter() - began:.0f} s)")
