"""Curves read from run folders, grouped by task and method."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from earl_jax.envs import make
from earl_jax.errors import InputError
from earl_jax.metrics.continuing import count_diverged
from earl_jax.protocol import Deployment
from earl_jax.report.life_columns import LATER_METRICS
from earl_jax.report.style import method_order, task_order
from earl_jax.runs.config import RunConfig
from earl_jax.runs.contents import METRICS
from earl_jax.runs.folder import RunFolder

SAME_TASK = frozenset({"physics", "demo_file", "variant", "reward_type"})
"""Options of a task with which it is still the paper's task; `comparable` checks the kind of reward."""


class Curves(NamedTuple):
    """Evaluations of N seeds of one method on one task: `steps [E]` and `metrics` of arrays [N, E]."""

    config: RunConfig
    steps: np.ndarray
    metrics: dict[str, np.ndarray]

    @property
    def deployed_metric(self) -> str:
        """The metric that scores a deployed policy on this task."""
        return self.config.deployed_metric

    @property
    def diverged(self) -> int:
        """The number of seeds whose learner has diverged."""
        return count_diverged(self.metrics)

    @property
    def seeds(self) -> int:
        """N, the number of seeds."""
        return len(self.metrics[self.deployed_metric])

    @property
    def options(self) -> dict[str, Any]:
        """Options of task, setting and method that differ from the defaults."""
        config = self.config
        setting = {key: value for key, value in config.setting.items() if key != "name"}
        if config.setting["name"] != Deployment.name:
            setting = {"setting": config.setting["name"], **setting}
        return {**config.env_options, **setting, **config.options}

    @property
    def comparable(self) -> bool:
        """Whether the task, its kind of reward (sparse or dense) and the setting are those of the paper's tables."""
        config = self.config
        same_task = config.env_options.keys() <= SAME_TASK
        same_reward = config.build_env().sparse == make(config.env).sparse
        return same_task and same_reward and config.build_setting() == Deployment()


class Columns(dict[str, np.ndarray]):
    """Metrics by name; a missing one is an InputError that names the folder `path` of the run."""

    def __init__(self, path: Path, metrics: dict[str, np.ndarray]):
        super().__init__(metrics)
        self._path = path

    def __missing__(self, name: str) -> np.ndarray:
        raise InputError(f"{self._path / METRICS} has no column {name!r}; it has {', '.join(self)}")


class MethodRuns(NamedTuple):
    """The runs of one method on one task; `label` is its name with the options that tell it from others there."""

    env: str
    algo: str
    label: str
    curves: Curves


def read(path: Path) -> Curves:
    """Return the curves of one run folder, up to its last complete evaluation.

    Raises:
        ValueError: the folder holds no run, or a run without an evaluation, or rows of its metrics are missing.
    """
    folder = RunFolder.open(path)
    try:
        folder.config.build_env()
    except InputError as error:  # it names the choices, but not the run
        raise InputError(f"{path}: {error}") from error
    rows = folder.rows()
    if not rows:
        raise InputError(f"{path} has no evaluation yet")
    steps, metrics = folder.config.curves(rows)
    return Curves(folder.config, steps, Columns(path, metrics))


def read_all(folders: Sequence[Path]) -> list[Curves]:
    """Return the curves of `folders`; seeds of the same task, method and options are pooled over their common steps.

    Raises:
        ValueError: no folder is given, one of them cannot be read, or runs to pool have no step in common.
    """
    if not folders:
        raise InputError("name at least one run folder")
    groups: dict[str, list[Curves]] = {}
    paths: dict[str, Path] = {}
    for path in folders:
        curves = read(path)
        key = pooling_key(curves.config)
        groups.setdefault(key, []).append(curves)
        paths.setdefault(key, path)
    return [_pooled(paths[key], group) for key, group in groups.items()]


def pooling_key(config: RunConfig) -> str:
    """Return a text that is the same for runs whose seeds can be pooled: same task, setting, method and options."""
    return repr((config.env, config.env_options, config.setting, config.algo, config.options))


def _pooled(path: Path, group: list[Curves]) -> Curves:
    """Return the pooled curves of `group`, of which `path` is the first folder."""
    steps = group[0].steps
    for other in group[1:]:
        steps = np.intersect1d(steps, other.steps)
    if not len(steps):
        raise InputError(f"runs of {group[0].config.algo} have no evaluation step in common")
    masks = [np.isin(part.steps, steps) for part in group]
    metrics = {
        name: np.concatenate([part.metrics[name][:, mask] for part, mask in zip(group, masks, strict=True)])
        for name in group[0].metrics
        if name not in LATER_METRICS or all(name in part.metrics for part in group)  # earlier versions did not write it
    }
    return Curves(group[0].config, steps, Columns(path, metrics))


def labels(runs: Sequence[Curves]) -> list[str]:
    """Return a label for each of `runs`: its method, with the options in which its runs on the same task differ."""
    peers: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for curves in runs:
        peers.setdefault((curves.config.env, curves.config.algo), []).append(curves.options)
    return [label(curves.config.algo, curves.options, peers[curves.config.env, curves.config.algo]) for curves in runs]


def label(algo: str, options: dict[str, Any], peers: Sequence[dict[str, Any]]) -> str:
    """Return the name of a method with those of its `options` in which its `peers` differ."""
    keys = sorted({key for other in peers for key in other})
    differing = [key for key in keys if any(other.get(key) != options.get(key) for other in peers)]
    text = ", ".join(f"{key}={options.get(key, 'default')}" for key in differing)
    return f"{algo} ({text})" if text else algo


def read_methods(folders: Sequence[Path]) -> list[MethodRuns]:
    """Return the pooled runs of `folders`, by task and method in the paper's order. Errors as `read_all`."""
    return by_method(read_all(folders))


def by_method(runs: Sequence[Curves]) -> list[MethodRuns]:
    """Return `runs` with their labels, by task and method in the paper's order.

    The label of a run with default options is the bare name of its method.
    """
    groups = []
    for env in task_order(curves.config.env for curves in runs):
        of_task = [curves for curves in runs if curves.config.env == env]
        for algo in method_order(curves.config.algo for curves in of_task):
            peers = [curves for curves in of_task if curves.config.algo == algo]
            options = [curves.options for curves in peers]
            names = [label(algo, changed, options) if changed else algo for changed in options]
            groups += [MethodRuns(env, algo, name, curves) for name, curves in zip(names, peers, strict=True)]
    return groups


def options_text(options: dict[str, Any]) -> str:
    """Return changed options in one line, or `the defaults` if there are none."""
    return ", ".join(f"{name}={value}" for name, value in sorted(options.items())) or "the defaults"
