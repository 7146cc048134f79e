"""The command that trains a small preset on a laptop's CPU: quickstart, also `make quickstart`."""

import time
from pathlib import Path

ALGO = "fbrl"
SEEDS = 2
STEPS = 170_000
EPISODES = 20
PRESET = {
    "hidden_sizes": (64, 64),
    "batch_size": 64,
    "learning_rate": 1e-3,
    "timeout_bootstrap": True,
    "demo_share": 0.5,
    "layer_norm": True,
}
"""Hyper-parameters that learn within minutes on a laptop. Task, rewards, phases, evaluation and the lack of resets are the
paper's."""

CHANGES = """\
Forward-backward RL on tabletop organization, without resets: the paper's task, sparse reward, phases and evaluation.
A small preset, not the paper's: {steps:,} steps instead of 2.5M, {seeds} seeds, networks of 64-64 instead of 256-256, batch 64
instead of 256, learning rate 1e-3 instead of 3e-4, bootstrapping through time-outs, half of each batch from the
demonstrations, layer norm in the critics, {episodes} episodes per evaluation instead of 10.
"""


def quickstart(out: Path = Path("runs/quickstart"), steps: int | None = None) -> None:
    """Train forward-backward RL on tabletop organization on a CPU within minutes, and draw its curves.

    Args:
        out: New folder for the run, curves.png and table.md.
        steps: Training steps of each seed. By default 170,000.
    """
    from earl_jax.report.plots import plot_runs
    from earl_jax.report.tables import markdown, tabulate, write
    from earl_jax.training import train

    began = time.perf_counter()
    steps = steps or STEPS
    print(CHANGES.format(steps=steps, seeds=SEEDS, episodes=EPISODES))
    run = out / ALGO
    result = train(
        "tabletop_organization",
        ALGO,
        seeds=SEEDS,
        steps=steps,
        eval_every=min(10_000, steps),
        eval_episodes=EPISODES,
        out=run,
        checkpoint_every=steps,
        progress=True,
        **PRESET,
    )
    figure = plot_runs([run], out / "curves.png")
    table = out / "table.md"
    rows = tabulate([run], last=3)
    write(rows, table)
    success = result.metrics["deployed/success"].mean(axis=0)
    print(f"\n{markdown(rows)}\n")
    print(f"deployed success: best {success.max():.2f}, mean of the last three evaluations {success[-3:].mean():.2f}")
    print(f"figure: {figure}\ntable:  {table}\nrun:    {run}   ({time.perf_counter() - began:.0f} s)")
