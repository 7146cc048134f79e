"""Curves read from run folders, grouped by task and method."""

import json
import os
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from earl_jax.envs import make
from earl_jax.errors import InputError
from earl_jax.metrics.continuing import DIVERGED, count_diverged
from earl_jax.metrics.deployed import WIDE
from earl_jax.metrics.life import LIFE_METRICS
from earl_jax.protocol import Deployment
from earl_jax.report.style import method_order, task_order
from earl_jax.runs.config import RunConfig
from earl_jax.runs.contents import CHECKPOINTS, CONFIG, METRICS
from earl_jax.runs.files import RunWarning
from earl_jax.runs.folder import RunFolder

OPTIONAL_METRICS = frozenset({DIVERGED, WIDE, *LIFE_METRICS})
"""Metrics that some runs do not have."""
SAME_TASK = frozenset({"engine", "demo_file", "variant", "reward_type"})
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


def find_runs(folders: Sequence[Path]) -> list[Path]:
    """Return the run folders in and below `folders`, each once; links to folders are not followed.

    Raises:
        ValueError: a folder does not exist, or holds no run.
    """
    if not folders:
        raise InputError("name at least one run folder, or a folder of them")
    paths: dict[Path, Path] = {}
    for folder in folders:
        if not folder.is_dir():
            raise InputError(f"{folder} is not a folder")
        below = list(_runs_below(folder))
        if not below:
            raise InputError(f"{folder} is not a run folder and holds none: no config.json in it or below")
        for path in below:
            paths.setdefault(path.resolve(), path)
    return list(paths.values())


def _runs_below(folder: Path) -> Iterator[Path]:
    for path, folders, files in os.walk(folder):
        folders[:] = sorted(set(folders) - {CHECKPOINTS})
        if "config.json" in files or "metrics.csv" in files:
            yield Path(path)


def read_all(folders: Sequence[Path]) -> list[Curves]:
    """Return the curves of `folders`; seeds of the same task, method and options are pooled over their common steps.

    A folder that is no run folder itself, such as that of a sweep, stands for the runs below it. A run found so that
    cannot be read, for example one without an evaluation yet, is left out with a `RunWarning`.

    Raises:
        ValueError: no folder is given, one of them cannot be read or holds no run that can, or runs to pool have no step in
            common.
    """
    if not folders:
        raise InputError("name at least one run folder")
    groups: dict[str, list[Curves]] = {}
    paths: dict[str, Path] = {}
    for path, curves in _read_below(folders):
        key = pooling_key(curves.config)
        groups.setdefault(key, []).append(curves)
        paths.setdefault(key, path)
    return [pooled(paths[key], group) for key, group in groups.items()]


def _read_below(folders: Sequence[Path]) -> Iterator[tuple[Path, Curves]]:
    """Yield the folder and the curves of each run in `folders`. Errors as `read_all`."""
    for folder in folders:
        if (folder / CONFIG).is_file() or not folder.is_dir():
            yield folder, read(folder)
            continue
        paths, causes = find_runs([folder]), []
        for path in paths:
            try:
                yield path, read(path)
            except InputError as error:
                causes.append(str(error))
                warnings.warn(f"left out: {error}", RunWarning, stacklevel=2)
        if len(causes) == len(paths):
            raise InputError(f"no run below {folder} can be read: {causes[0]}")


def pooling_key(config: RunConfig) -> str:
    """Return a text that is the same for runs whose seeds can be pooled: same task, setting, method and options."""
    values = [config.env, config.env_options, config.setting, config.algo, config.options]
    return json.dumps(values, sort_keys=True, default=repr)


def pooled(path: Path, group: list[Curves]) -> Curves:
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
        if name not in OPTIONAL_METRICS or all(name in part.metrics for part in group)
    }
    return Curves(group[0].config, steps, Columns(path, metrics))


def labels(runs: Sequence[Curves]) -> list[str]:
    """Return a label for each of `runs`: its method, with the options in which its runs on the same task differ."""
    peers: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for curves in runs:
        peers.setdefault((curves.config.env, curves.config.algo), []).append(curves.options)
    return [label(curves.config.algo, curves.options, peers[curves.config.env, curves.config.algo]) for curves in runs]


def label(algo: str, options: dict[str, Any], peers: Sequence[dict[str, Any]]) -> str:
    """Return the name of a method with those of its changed `options` in which its `peers` differ.

    An option with its default value is not named, so a run with the defaults has the bare name.
    """
    named = [key for key in sorted(options) if any(other.get(key) != options[key] for other in peers)]
    text = ", ".join(f"{key}={options[key]}" for key in named)
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
            names = [label(algo, changed, options) for changed in options]
            groups += [MethodRuns(env, algo, name, curves) for name, curves in zip(names, peers, strict=True)]
    return groups


def options_text(options: dict[str, Any]) -> str:
    """Return changed options in one line, or `the defaults` if there are none."""
    return ", ".join(f"{name}={value}" for name, value in sorted(options.items())) or "the defaults"
