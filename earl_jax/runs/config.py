"""The configuration of a run: all values that config.json needs to repeat it."""

import dataclasses
import json
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from earl_jax.algos import Method, make_algo, preset_learner
from earl_jax.algos.method import check_method
from earl_jax.envs import Env, make
from earl_jax.errors import PACKAGE, InputError, brief, require_known
from earl_jax.metrics.scores import as_decimals
from earl_jax.options.imports import Record, check_records, latest, records, short_hash
from earl_jax.options.registry import ALGOS, ENVS, LEARNER, LEARNERS, Registry, class_name
from earl_jax.options.schedule import FIELDS, Schedule, require_whole_windows
from earl_jax.options.seeds import seed_list
from earl_jax.options.values import check_intervals, check_storable
from earl_jax.protocol import SETTINGS, Deployment, Protocol, Setting, setting_of, split_setting
from earl_jax.runs.files import warn

RESERVED = frozenset({"env", "name"})
"""Names that no option has: parameters of the functions that take options by name."""
RECORDS = frozenset({"reward_type", "imports"})
"""Fields that do not tell runs apart."""
DEPLOYED = {"sparse": "deployed/success", "dense": "deployed/return"}
"""The deployed metric of a task by its reward type."""


@dataclasses.dataclass(frozen=True)
class RunConfig:
    """The names, options that differ from the defaults, seeds and schedule of a run.

    The objects of a run are resolved once and passed along with its config. `build_env` and the other builders are for
    runs that are read from a folder. `env_class` and `algo_class` name the class of an object that its registered name
    does not build.
    """

    env: str
    env_options: dict[str, Any]
    algo: str
    options: dict[str, Any]
    seeds: tuple[int, ...]
    steps: int
    eval_every: int
    eval_episodes: int
    checkpoint_every: int
    reward_type: str = dataclasses.field(compare=False)
    """That of the task, so that its runs can be read without its class."""
    setting: dict[str, Any] = dataclasses.field(default_factory=lambda: {"name": Deployment.name})
    """The name of the setting, and its options that differ from the defaults."""
    env_class: str | None = None
    algo_class: str | None = None
    imports: list[Record] = dataclasses.field(default_factory=list, compare=False)
    """The files of `--import` with which the run was trained. No command runs what a config names."""

    def __post_init__(self):
        kinds = {"env": str, "env_options": dict, "algo": str, "options": dict, "setting": dict}
        for field, kind in kinds.items():
            value = getattr(self, field)
            if not isinstance(value, kind):
                raise InputError(f"{field} must be a {kind.__name__}, not {brief(value)}")
            for name, option in value.items() if isinstance(value, dict) else ():
                check_storable(f"{name!r} in {field}", option)
        if "name" not in self.setting:
            raise InputError(f"setting has no name: {brief(self.setting)}")
        for field in ("env_class", "algo_class"):
            if not isinstance(getattr(self, field), str | None):
                raise InputError(f"{field} must be text or null, not {brief(getattr(self, field))}")
        require_known("reward_type", self.reward_type, DEPLOYED)
        check_records(self.imports)
        reserved = RESERVED & {*self.env_options, *self.options}
        if reserved:
            raise InputError(f"there is no option {min(reserved)!r}")
        seeds = seed_list(self.seeds)
        self.schedule.check()
        plain = {"seeds": seeds, **{name: int(getattr(self, name)) for name in FIELDS}}
        for field, value in plain.items():
            object.__setattr__(self, field, value)  # JSON has a list of seeds and no number of NumPy
        require_whole_windows(self.steps, self.eval_every)

    @classmethod
    def from_objects(
        cls, env: Env, method: Method, setting: Setting, seeds: tuple[int, ...], schedule: Schedule
    ) -> "RunConfig":
        """Return the config of built objects, whose `eval_every` is at most the steps of `schedule`.

        Raises:
            InputError: an option is outside its interval, a number of `schedule` or a seed is invalid, or the setting is an
                object of another class, whose name would build an object of ours.
        """
        schedule.check()
        task, setting = split_setting(env, setting)
        if type(setting) not in SETTINGS.values():
            known = " or ".join(cls.__name__ for cls in SETTINGS.values())
            raise InputError(f"the setting of a run must be an object of {known}, not of {type(setting).__name__}")
        check_method(method)
        check_intervals(task.name, task)
        return cls(
            env=task.name,
            env_options=_changed_options(task),
            algo=method.name,
            options=method_options(method),
            seeds=seeds,
            **dataclasses.asdict(schedule.changed(eval_every=min(schedule.eval_every, schedule.steps))),
            setting={"name": setting.name, **_changed_options(setting)},
            env_class=_unregistered_class(task, ENVS),
            algo_class=_unregistered_class(method, ALGOS),
            reward_type=task.reward_type,
            imports=records(),
        )

    @classmethod
    def from_stored(cls, values: Mapping[str, Any]) -> "RunConfig":
        """Return the config in the `values` of a config.json, which has other entries too.

        Raises:
            KeyError: a field without a default is missing.
            InputError: a value is invalid.
        """
        known = {}
        for field in dataclasses.fields(cls):
            is_required = field.default is field.default_factory is dataclasses.MISSING
            if is_required or field.name in values:
                known[field.name] = values[field.name]
        return cls(**known)

    @property
    def schedule(self) -> Schedule:
        """The steps of the run, its evaluations and its checkpoints."""
        return Schedule(**{name: getattr(self, name) for name in FIELDS})

    @property
    def values(self) -> dict[str, Any]:
        """The fields that tell runs apart, as config.json has them."""
        fields = dataclasses.asdict(self).items()
        known = {name: value for name, value in fields if name not in RECORDS}
        return json.loads(json.dumps(known, default=repr))  # a run without a folder can have options that JSON lacks

    def build_setting(self) -> Setting:
        """Return the setting with its options."""
        return setting_of(**self.setting)

    def build_task(self) -> Env:
        """Return the task, without the help that the setting can add.

        Raises:
            ValueError: the run was trained on an object of a class that its name does not build; the message names the
                class.
        """
        self._require_class(ENVS, self.env, self.env_class)
        return make(self.env, **self.env_options)

    def build_env(self) -> Env:
        """Return the task, wrapped in a `HelpBudget` if the setting has a budget. Errors as `build_task`."""
        return self.build_setting().wrap(self.build_task())

    def build_method(self) -> Method:
        """Return the method with its hyper-parameters. Errors as `build_task`."""
        self._require_class(ALGOS, self.algo, self.algo_class)
        self._require_class(LEARNERS, self.options.get("learner", LEARNER))
        return make_algo(self.algo, **self.options)

    def require_objects(self, task: Env | None, method: Method | None) -> None:
        """Raise an InputError if `task` or `method`, where one is given, has another name or other options than this run's."""
        if task is not None:
            _require_equal(ENVS, {"name": self.env, **self.env_options}, {"name": task.name, **_changed_options(task)})
        if method is not None:
            _require_equal(ALGOS, {"name": self.algo, **self.options}, {"name": method.name, **method_options(method)})

    @property
    def deployed_metric(self) -> str:
        """The name of the task's deployed metric: success for sparse rewards, return for dense ones."""
        return DEPLOYED[self.reward_type]

    def _require_class(self, registry: Registry, name: Any, trained: str | None = None) -> None:
        """Raise an InputError if `name` has another class here than the one named `trained`, or if it is unknown.

        The latter names the files of this run; without any, an unknown name is left to `registry`.
        """
        if trained is not None and trained != _registered_class(registry, name):
            cls, kind = trained.rpartition(":")[2].rpartition(".")[2], registry.kind
            remedy = f"import that module and call earl_jax.register_{kind}({name!r}, {cls}), or pass"
            if name in registry.names():
                remedy = "another class has its name; pass"
            raise InputError(
                f"this run was trained with {registry.noun} {name!r} as an object of {trained}, which is not "
                f"registered here; {remedy} the object to continue the run: earl_jax.resume(folder, {kind}=...)"
            )
        if not self.imports or name in registry.names():
            return
        files = latest(self.imports).values()
        named = " and ".join(f"{record['file']} (sha256 {short_hash(record)})" for record in files)
        options = " ".join(f"--import {shlex.quote(record['file'])}" for record in files)
        raise InputError(f"unknown {registry.noun} {name!r}: this run was trained with {named}: pass {options}")

    def warn_of_changes(self, path: Path) -> None:
        """Warn if a file of this run, whose folder is `path`, was imported here with another text."""
        now = latest(records())
        for name, then in latest(self.imports).items():
            if name in now and now[name]["sha256"] != then["sha256"]:
                texts = f"sha256 {short_hash(then)} then, {short_hash(now[name])} now"
                warn(f"{name} has changed since {path} was trained ({texts})")

    def protocol(self, env: Env) -> Protocol:
        """Return the protocol: the task's horizons, the setting's rules, this run's evaluations."""
        return self.build_setting().protocol(env, self.eval_every, self.eval_episodes)

    def checkpoint_due(self, step: int) -> bool:
        """Return whether a run ends at `step`, or has passed a multiple of `checkpoint_every` since the last evaluation."""
        passed = step // self.checkpoint_every > (step - self.eval_every) // self.checkpoint_every
        return passed or step == self.steps


def method_options(method: Method) -> dict[str, Any]:
    """Return the hyper-parameters of `method` that differ from its class's defaults, as plain values.

    `learner` is the name of a learner of another class than the method's own. Of classes outside this package, whose
    defaults can change, the defaults are there too.
    """
    default, learner = type(method)(), type(method.learner)
    options: dict[str, Any] = {} if learner is type(default.learner) else {"learner": learner.name}
    preset = preset_learner(type(method), learner) if _is_ours(method) else learner()
    for part, other in ((method.learner, preset), (method, default)):
        for field in dataclasses.fields(part):
            plain, usual = _plain(getattr(part, field.name)), getattr(other, field.name)
            if isinstance(usual, bool) and isinstance(plain, float):
                plain = bool(plain)  # lanes have flags as numbers
            if field.name != "learner" and (plain != usual or _can_change(part, plain)):
                options[field.name] = plain
    return options


def _is_ours(owner: Any) -> bool:
    return type(owner).__module__.partition(".")[0] == PACKAGE.name


def _can_change(owner: Any, value: Any) -> bool:
    """Return whether the default `value` of a field of `owner` can change between releases of this package, and is storable."""
    items = value if isinstance(value, tuple) else (value,)
    return not _is_ours(owner) and all(isinstance(item, bool | int | float | str | None) for item in items)


def _require_equal(registry: Registry, own: Mapping[str, Any], given: Mapping[str, Any]) -> None:
    """Raise an InputError if the values of a run's task or method differ from those of the object that was passed."""
    own, given = (json.loads(json.dumps(values, default=repr)) for values in (own, given))
    for name in {**own, **given}:
        then, now = (values.get(name, "the default") for values in (own, given))
        if then != now:
            known = f"{registry.noun} of this run has the {name} {brief(then)}"
            raise InputError(f"the {known}, and the object passed has {brief(now)}")


def _plain(value: Any) -> Any:
    """Return an array or a number of NumPy as plain numbers, as one if those of all lanes are equal; other values as they are."""
    if isinstance(value, tuple):
        return tuple(map(_plain, value))
    if not hasattr(value, "shape"):
        return value
    values = as_decimals(np.asarray(value)).tolist()
    return values[0] if isinstance(values, list) and len({*map(repr, values)}) == 1 else values


def _changed_options(options: Any) -> dict[str, Any]:
    """Return the fields of a dataclass that differ from its defaults, and the others as `method_options`."""
    values = ((field, _plain(getattr(options, field.name))) for field in dataclasses.fields(options))
    return {field.name: value for field, value in values if value != field.default or _can_change(options, value)}


def _registered_class(registry: Registry, name: str) -> str | None:
    """Return the name of the class that `name` is registered for, or None."""
    try:
        return class_name(registry.get(name))
    except ValueError:
        return None


def _unregistered_class(target: Any, registry: Registry) -> str | None:
    """Return the class name of `target` if its name is not registered, or registered for another class; else None."""
    own = class_name(type(target))
    return None if own == _registered_class(registry, target.name) else own
