"""Curves out of run folders, grouped by task and method."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from earl_jax.experiment import Experiment, RunFolder


class Curves(NamedTuple):
    """What the seeds of one method earned on one task: `steps [E]` and `metrics` of arrays [N, E]."""

    experiment: Experiment
    steps: np.ndarray
    metrics: dict[str, np.ndarray]


def read(path: Path) -> Curves:
    """Return the curves of one run folder; one without an evaluation yet is a ValueError."""
    folder = RunFolder.open(path)
    rows = folder.rows()
    per_step = len(folder.experiment.seeds)
    rows = rows[: len(rows) // per_step * per_step]
    if not rows:
        raise ValueError(f"{path} has no evaluation yet")
    return Curves(folder.experiment, *folder.experiment.curves(rows))


def read_all(folders: Sequence[Path]) -> list[Curves]:
    """Return the curves of `folders`, seeds of the same task, method and options pooled over their common steps."""
    if not folders:
        raise ValueError("name at least one run folder")
    groups: dict[str, list[Curves]] = {}
    for path in folders:
        curves = read(path)
        one = curves.experiment
        groups.setdefault(repr((one.env, one.env_options, one.algo, one.options)), []).append(curves)
    return [_pool(group) for group in groups.values()]


def _pool(group: list[Curves]) -> Curves:
    steps = group[0].steps
    for other in group[1:]:
        steps = np.intersect1d(steps, other.steps)
    if not len(steps):
        raise ValueError(f"runs of {group[0].experiment.algo} have no evaluation step in common")
    picked = [np.isin(part.steps, steps) for part in group]
    metrics = {
        name: np.concatenate([part.metrics[name][:, pick] for part, pick in zip(group, picked, strict=True)])
        for name in group[0].metrics
    }
    return Curves(group[0].experiment, steps, metrics)


def label(curves: Curves) -> str:
    """Return a method's name with the options that were changed, for a legend or a row."""
    options = ", ".join(f"{name}={value}" for name, value in sorted(curves.experiment.options.items()))
    return f"{curves.experiment.algo} ({options})" if options else curves.experiment.algo
