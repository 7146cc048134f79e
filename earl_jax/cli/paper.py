"""The command that reproduces the paper: reproduce."""

import itertools
from pathlib import Path
from typing import Literal

from earl_jax.cli.arguments import (
    Devices,
    Minutes,
    PerDevice,
    Positional,
    Set,
    parse_minutes,
    parse_options,
    print_line,
)


def reproduce(
    name: Positional[Literal["table1", "table2", "figure2", "figure3", "figure4", "figure5", "tradeoff"]],
    scale: Literal["smoke", "short", "full"] = "smoke",
    out: Path | None = None,
    tasks: tuple[str, ...] = (),
    seeds: int | None = None,
    steps: int | None = None,
    max_lanes: int | None = None,
    devices: Devices = None,
    per_device: PerDevice = None,
    minutes: Minutes = None,
    set: Set = (),
) -> None:
    """Train and draw a table or figure of the paper beside the published one. After a kill, repeat the command to continue.

    Args:
        name: Table or figure, or the trade-off of learning against interventions that the conclusion names.
        scale: smoke trains one task for a few hundred steps; short, a tenth of the published steps; full, all of them.
        out: Folder that all tables and figures share for runs and results. runs/reproduce-SCALE by default.
        tasks: Tasks to include. By default those of the scale.
        seeds: Number of seeds. By default 2, 3 or 5, as the scale has.
        steps: Training steps of each seed. By default those of the scale.
        max_lanes: Largest number of lanes (runs x seeds) in one program. By default there is no limit.
    """
    limit = parse_minutes(minutes)
    from earl_jax.paper import reproduce as paper

    paths = paper.reproduce(
        name,
        scale,
        out,
        tasks=tasks,
        seeds=seeds,
        steps=steps,
        options=parse_options(itertools.chain(*set)),
        max_lanes=max_lanes,
        devices=devices,
        per_device=per_device,
        minutes=limit,
        emit=print_line,
    )
    for path in paths:
        print(path)
