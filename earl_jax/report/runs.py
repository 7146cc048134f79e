"""Curves out of run folders, grouped by task and method."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from earl_jax.envs import make
from earl_jax.protocol import Deployment
from earl_jax.report.style import COLOURS, TITLES, ordered
from earl_jax.runs.config import RunConfig
from earl_jax.runs.folder import RunFolder


class Curves(NamedTuple):
    """What the seeds of one method earned on one task: `steps [E]` and `metrics` of arrays [N, E]."""

    config: RunConfig
    steps: np.ndarray
    metrics: dict[str, np.ndarray]

    @property
    def deployed_metric(self) -> str:
        """The metric that the task is judged by when it is deployed."""
        return self.config.deployed_metric

    @property
    def options(self) -> dict[str, Any]:
        """Options of task, setting and method that differ from the defaults."""
        one = self.config
        name, changed = one.setting["name"], {key: value for key, value in one.setting.items() if key != "name"}
        return {**one.env_options, **({} if name == Deployment.name else {"setting": name}), **changed, **one.options}

    @property
    def comparable(self) -> bool:
        """Whether reward, sparse or dense, and setting are those of the paper's tables."""
        one = self.config
        return one.build_env().sparse == make(one.env).sparse and one.build_setting() == Deployment()


def read(path: Path) -> Curves:
    """Return the curves of one run folder; one without an evaluation yet is a ValueError."""
    folder = RunFolder.open(path)
    rows = folder.rows()
    per_step = len(folder.config.seeds)
    rows = rows[: len(rows) // per_step * per_step]
    if not rows:
        raise ValueError(f"{path} has no evaluation yet")
    return Curves(folder.config, *folder.config.curves(rows))


def read_all(folders: Sequence[Path]) -> list[Curves]:
    """Return the curves of `folders`, seeds of the same task, method and options pooled over their common steps."""
    if not folders:
        raise ValueError("name at least one run folder")
    groups: dict[str, list[Curves]] = {}
    for path in folders:
        curves = read(path)
        one = curves.config
        groups.setdefault(repr((one.env, one.env_options, one.setting, one.algo, one.options)), []).append(curves)
    return [_pool(group) for group in groups.values()]


def _pool(group: list[Curves]) -> Curves:
    steps = group[0].steps
    for other in group[1:]:
        steps = np.intersect1d(steps, other.steps)
    if not len(steps):
        raise ValueError(f"runs of {group[0].config.algo} have no evaluation step in common")
    picked = [np.isin(part.steps, steps) for part in group]
    metrics = {
        name: np.concatenate([part.metrics[name][:, pick] for part, pick in zip(group, picked, strict=True)])
        for name in group[0].metrics
    }
    return Curves(group[0].config, steps, metrics)


def labels(runs: Sequence[Curves]) -> list[str]:
    """Return a name for each run: its method, with those options in which runs of that method here differ."""
    named = [(curves.config.env, curves.config.algo, curves.options) for curves in runs]
    return [
        label(algo, own, [options for *place, options in named if place == [env, algo]]) for env, algo, own in named
    ]


def label(algo: str, own: dict[str, Any], peers: Sequence[dict[str, Any]]) -> str:
    """Return the name of a method, with those of its `own` options in which its `peers` differ."""
    keys = sorted({key for options in peers for key in options})
    differing = [key for key in keys if any(options.get(key) != own.get(key) for options in peers)]
    told = ", ".join(f"{key}={own.get(key, 'default')}" for key in differing)
    return f"{algo} ({told})" if told else algo


class Cell(NamedTuple):
    """The runs of one method on one task: `label` is its name, with the options that tell it from others there."""

    env: str
    algo: str
    label: str
    curves: Curves


def cells(folders: Sequence[Path]) -> list[Cell]:
    """Return the curves of `folders` as `read_all` pools them, by task and method in the paper's order."""
    return cells_of(read_all(folders))


def cells_of(runs: Sequence[Curves]) -> list[Cell]:
    """Return `runs`, each with its name, by task and method in the paper's order."""
    bare = [Cell(one.config.env, one.config.algo, "", one) for one in runs]
    found = []
    for env in ordered((cell.env for cell in bare), TITLES):
        for algo in ordered((cell.algo for cell in bare if cell.env == env), COLOURS):
            peers = [cell for cell in bare if (cell.env, cell.algo) == (env, algo)]
            options = [cell.curves.options for cell in peers]
            names = [label(algo, own, options) if own else algo for own in options]
            found += [cell._replace(label=name) for cell, name in zip(peers, names, strict=True)]
    return found


def described(options: dict[str, Any]) -> str:
    """Return changed options in one line, or that they are the defaults."""
    return ", ".join(f"{name}={value}" for name, value in sorted(options.items())) or "the defaults"
