"""Curves read from run folders, grouped by task and method."""

import copy
import dataclasses
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from earl_jax.algos import preset_learner
from earl_jax.envs import PAPER_TASKS, env_class, make
from earl_jax.errors import InputError, printable
from earl_jax.metrics.continuing import count_diverged
from earl_jax.metrics.scores import CONTINUING, DEFAULT, Score, Window
from earl_jax.options.registry import LEARNERS
from earl_jax.options.values import value_text
from earl_jax.protocol import SETTINGS, Deployment
from earl_jax.report.style import grouped, method_order, task_order
from earl_jax.runs.config import RunConfig, method_options
from earl_jax.runs.contents import METRICS
from earl_jax.runs.files import warn
from earl_jax.runs.folder import RunFolder

CLASSES = {"env_class": None, "algo_class": None}
"""The classes of task and method that `Curves.options` has where a name does not build them."""
SAME_TASK = frozenset({"engine", "demo_file", "reward_type"})
"""Options of a task with which it is still the paper's task; `comparable` checks the kind of reward."""


class Curves(NamedTuple):
    """Evaluations of N seeds of one method on one task: `steps [E]` and `metrics` of arrays [N, E].

    `runs` are the folders of the runs that the seeds come from, each with the config of these seeds alone, and `window` has
    the evaluations that score them. `label` is their method with the options that tell it from others on the task, where
    `by_method` has compared them.
    """

    config: RunConfig
    steps: np.ndarray
    metrics: dict[str, np.ndarray]
    runs: tuple[RunFolder, ...] = ()
    window: Window = DEFAULT
    label: str = ""

    @property
    def env(self) -> str:
        """The name of the task."""
        return self.config.env

    @property
    def algo(self) -> str:
        """The name of the method."""
        return self.config.algo

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
    def length(self) -> int:
        """The step of the last evaluation."""
        return int(self.steps[-1])

    def score(self, metric: str | None = None) -> Score:
        """Return the score of the seeds over the evaluations of `window`, by default of the deployed metric."""
        return Score.of(self.steps, self.metrics, metric or self.deployed_metric, self.deployed_metric, self.window)

    def until(self, step: float) -> "Curves":
        """Return the evaluations up to `step`; an InputError if there is none."""
        until = self.steps <= step
        if not until.any():
            raise InputError(f"{self.algo} on {self.env} has no evaluation in the first {step:,} steps")
        metrics = copy.copy(self.metrics)
        metrics.update({name: values[:, until] for name, values in metrics.items()})
        return self._replace(steps=self.steps[until], metrics=metrics)

    @property
    def run_seeds(self) -> list[int]:
        """The seeds of `runs` in their order, with repetition; of a seed that ran more than once, the curves have one row."""
        return [seed for run in self.runs for seed in run.config.seeds]

    @property
    def repeated_seeds(self) -> list[int]:
        """The seeds that ran more than once."""
        return [seed for seed, count in Counter(self.run_seeds).items() if count > 1]

    @property
    def task_options(self) -> dict[str, Any]:
        """Options of task and setting that differ from the defaults, and the task's class if its name does not build it."""
        config = self.config
        setting = {key: value for key, value in config.setting.items() if key != "name"}
        if config.setting["name"] != Deployment.name:
            setting = {"setting": config.setting["name"], **setting}
        return {**config.env_options, **setting, **({"env_class": config.env_class} if config.env_class else {})}

    @property
    def options(self) -> dict[str, Any]:
        """Those options, those of the method, and its class if its name does not build it."""
        own_class = {"algo_class": self.config.algo_class} if self.config.algo_class else {}
        return {**self.task_options, **self.config.options, **own_class}

    @property
    def comparable(self) -> bool:
        """Whether the task, its kind of reward (sparse or dense) and the setting are those of the paper's tables."""
        config = self.config
        if config.env not in PAPER_TASKS or config.env_class or not config.env_options.keys() <= SAME_TASK:
            return False
        same_reward = config.reward_type == make(config.env).reward_type
        return same_reward and config.build_setting() == Deployment()


class Columns(dict[str, np.ndarray]):
    """Metrics by name; a missing one is an InputError that names the folder `path` of the run."""

    def __init__(self, path: Path, metrics: dict[str, np.ndarray]):
        super().__init__(metrics)
        self._path = path

    def __missing__(self, name: str) -> np.ndarray:
        raise InputError(f"{self._path / METRICS} has no column {name!r}; it has {', '.join(self)}")


def read(path: Path, window: Window = DEFAULT) -> Curves:
    """Return the curves of one run folder, up to its last complete evaluation.

    Raises:
        ValueError: the folder holds no run, or one without an evaluation, or with damaged rows.
    """
    folder = RunFolder.open(path)
    table = folder.table()
    if not len(table.steps):
        raise InputError(f"{path} has no evaluation yet")
    metrics = Columns(path, table.metrics)
    unknown = np.full_like(metrics[folder.config.deployed_metric], np.nan)
    metrics.setdefault(CONTINUING, unknown)  # of a run from elsewhere
    try:
        folder.config.build_setting()
    except InputError as error:  # it names the choices, but not the run
        raise InputError(f"{path}: {error}") from error
    return Curves(folder.config, table.steps, metrics, (folder,), window)


def by_values(curves: Curves) -> list[Curves]:
    """Return the curves of one run, apart for each set of hyper-parameters where its seeds have values of their own.

    They stay together where the class of the method is not known here, and a `RunWarning` says so.
    """
    config, folder, lanes = curves.config, curves.runs[0], range(len(curves.config.seeds))
    try:
        leaves, structure = jax.tree.flatten(config.build_method())
    except InputError:
        _warn_of_values(curves)
        return [curves]
    if not any(map(np.ndim, leaves)):
        return [curves]
    own = [structure.unflatten([leaf[lane] if np.ndim(leaf) else leaf for leaf in leaves]) for lane in lanes]
    options = list(map(method_options, own))
    parts = []
    for rows in grouped(lanes, lambda lane: str(options[lane])).values():
        part = dataclasses.replace(config, options=options[rows[0]], seeds=[config.seeds[row] for row in rows])
        metrics = Columns(folder.path, {name: values[rows] for name, values in curves.metrics.items()})
        parts.append(curves._replace(config=part, metrics=metrics, runs=(dataclasses.replace(folder, config=part),)))
    return parts


def _warn_of_values(curves: Curves) -> None:
    """Warn if the seeds of a run, whose method is not known here, have a list of numbers with a value for each."""
    for name, values in curves.config.options.items():
        if isinstance(values, list) and len(values) == len(curves.config.seeds) and float in map(type, values):
            cause = f"{curves.runs[0].path}: its seeds have different values of {name} and are taken together"
            remedy = "to tell them apart, pass the file of their method with --import"
            warn(f"{cause}; {remedy}")


def common_step(first: Curves, second: Curves, share: float = 1.0) -> int | None:
    """Return the last step, up to a `share` of those that both have, at which the run with rarer evaluations has one.

    It is None before the first evaluation of one.
    """
    rarer = max((first, second), key=lambda curves: spacing(curves.steps))
    steps = rarer.steps[rarer.steps <= int(share * min(first.length, second.length))]
    return int(steps[-1]) if len(steps) and steps[-1] >= max(first.steps[0], second.steps[0]) else None


def spacing(steps: np.ndarray) -> int:
    """Return the number of steps before the last of the evaluations at `steps [E]`, since the one before it or the start."""
    return int(np.diff(steps, prepend=0)[-1])


def labels(runs: Sequence[Curves]) -> list[str]:
    """Return a label for each of `runs`: its method, with the options in which runs on the same task differ.

    The runs of one method are told apart by all options, those of other methods by the learner and by options of task
    and setting, without `SAME_TASK`. A run with the default of such an option is labelled with it, or with `default`
    where its class is not known here.
    """
    tasks = grouped(runs, lambda curves: curves.env)
    on_task = {env: _differing(members, list(map(_shared_options, members))) for env, members in tasks.items()}
    found: dict[int, str] = {}
    for (env, algo), members in grouped(runs, lambda curves: (curves.env, curves.algo)).items():
        differing = (on_task[env] - SAME_TASK) | _differing(members, [curves.options for curves in members])
        found |= {id(curves): label(algo, _values(curves, differing)) for curves in members}
    return [found[id(curves)] for curves in runs]


def _shared_options(curves: Curves) -> dict[str, Any]:
    """Return the options that runs of all methods on a task can have."""
    learner = {name: value for name, value in curves.config.options.items() if name == "learner"}
    return {**curves.task_options, **learner}


def _differing(runs: Sequence[Curves], options: Sequence[dict[str, Any]]) -> set[str]:
    """Return the names in the `options` of `runs` that do not have the same value in all runs that have them."""
    names = {name for changed in options for name in changed}
    values = [{**CLASSES, **_values(curves, names)} for curves in runs]
    return {name for name in names if len({value_text(value[name]) for value in values if name in value}) > 1}


def _values(curves: Curves, names: Iterable[str]) -> dict[str, Any]:
    """Return the values of the options `names` of a run, without those that its task, setting and method do not have."""
    if not names:
        return {}
    config, defaults, unknown = curves.config, {"setting": Deployment.name}, {}
    parts: list[Any] = [SETTINGS[config.setting["name"]]]
    try:
        parts.append(env_class(config.env))
    except InputError:
        unknown = dict.fromkeys(names, "default")
    try:
        method = dataclasses.replace(config, options={}).build_method()
        parts.append(method)
        defaults["learner"] = learner = method.learner.name
        parts.append(preset_learner(type(method), LEARNERS.get(config.options.get("learner", learner))))
    except InputError:  # a run with a learner that is not known here has all options of that
        unknown = unknown if "learner" in defaults else dict.fromkeys(names, "default")
    fields = {field.name: getattr(part, field.name, "default") for part in parts for field in dataclasses.fields(part)}
    known = {**unknown, **fields, **defaults, **curves.options}
    return {name: known[name] for name in names if name in known}


def checked_labels(names: Sequence[str], lines: Sequence[str]) -> Sequence[str]:
    """Return the labels `names` given for `lines`, or `lines` themselves without any.

    Raises:
        ValueError: there are not as many; the message lists the lines in their order.
    """
    if names and len(names) != len(lines):
        raise InputError(
            f"there are {len(names)} labels for {len(lines)} runs; give one for each of: {'; '.join(lines)}"
        )
    return [printable(name) for name in names] or lines


def label(algo: str, options: dict[str, Any]) -> str:
    """Return the name of a method with `options`."""
    return f"{algo} ({options_text(options)})" if options else algo


def by_method(runs: Sequence[Curves]) -> list[Curves]:
    """Return `runs` with their `labels`, by task and method in the paper's order."""
    named = [curves._replace(label=name) for curves, name in zip(runs, labels(runs), strict=True)]
    envs, algos = task_order(curves.env for curves in runs), method_order(curves.algo for curves in runs)
    return sorted(named, key=lambda curves: (envs.index(curves.env), algos.index(curves.algo)))


def parts(result: Any, window: Window = DEFAULT) -> list[Curves]:
    """Return the labelled curves of a `Result` with a folder, apart for each set of hyper-parameters of its seeds."""
    return by_method(by_values(Curves(result.config, result.steps, result.metrics, (result.folder,), window)))


def part_scores(parts: Sequence[Curves]) -> dict[str, Any]:
    """Return the score of each of several `parts` of a run by its label, as JSON values; {} of a single one."""
    return {"part_scores": {part.label: part.score()._asdict() for part in parts}} if len(parts) > 1 else {}


def labelled(parts: Sequence[Curves], texts: list[str]) -> list[str]:
    """Return the text of each of the `parts` of a run, with its label if there are several."""
    return [f"{part.label}: {text}" for part, text in zip(parts, texts, strict=True)] if len(parts) > 1 else texts


def options_text(options: dict[str, Any]) -> str:
    """Return options in one line, or `the defaults` if there are none."""
    return printable(", ".join(f"{name}={value_text(options[name])}" for name in sorted(options))) or "the defaults"
