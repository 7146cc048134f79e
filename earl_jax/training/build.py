"""The objects of a run from names and options: its task, method and setting."""

import dataclasses
from typing import Any

from earl_jax.algos import Method, method_for
from earl_jax.envs import Env, env_class, make, with_engine
from earl_jax.errors import InputError, brief
from earl_jax.protocol import SETTINGS, Deployment, Setting, setting_of, split_setting, with_explicit_horizon
from earl_jax.runs.config import RESERVED


def build(env: str | Env, algo: str | Method, options: dict[str, Any]) -> tuple[Env, Method, Setting]:
    """Return the task, the method and the setting with their `options`. Errors as `train`."""
    task, setting, rest = split_options(env, options)
    if not isinstance(algo, str):
        if rest:
            fix = "go with a method's name; this method is an object: use .replace(...)"
            raise InputError(f"options {', '.join(rest)} {fix}")
        return task, algo, setting
    method = method_for(task, algo, **rest)
    of_method = {field.name for part in (method, method.learner) for field in dataclasses.fields(part)}
    if shared := of_method & (options.keys() - rest.keys()):
        owners = f"the task {task.name!r} and of the method {algo!r}"
        raise InputError(f"{min(shared)} is an option of {owners}: pass the method as an object, earl_jax.method_for")
    return task, method, setting


def split_options(env: str | Env, options: dict[str, Any]) -> tuple[Env, Setting, dict[str, Any]]:
    """Return the environment of the task `env`, the setting (`setting` in `options`), and the method's options.

    Raises:
        ValueError: the task or the setting is unknown, or one of their options is invalid.
    """
    rest = dict(options)
    chosen = rest.pop("setting", Deployment.name)
    setting = setting_of(chosen)
    task_options = _taken(rest, env_class(env) if isinstance(env, str) else env)
    setting_options = _taken(rest, setting)
    for owner, given, taken in (("task", env, task_options), ("setting", chosen, setting_options)):
        if taken and not isinstance(given, str):
            name, value = next(iter(taken.items()))
            fix = f"dataclasses.replace({owner}, {name}={value!r})"
            raise InputError(f"{name} is an option of the {owner}, which is an object here: pass {fix}")
    for other in SETTINGS.values():
        if name := min(_taken(dict(rest), other), default=None):
            raise InputError(f"{name} is an option of the setting {other.name!r}, but the setting is {setting.name!r}")
    reserved = RESERVED & set(rest)
    if reserved:
        raise InputError(f"there is no option {min(reserved)!r}")
    task = make(env, **task_options) if isinstance(env, str) else env
    if "engine" in rest:
        with_engine(task, rest["engine"])  # an error of a task without one
    setting = with_explicit_horizon(setting_of(chosen, **setting_options), task, task_options)
    task, setting = split_setting(task, setting)
    _require_plain(task)
    _require_plain(setting)
    return setting.wrap(task), setting, rest


def _require_plain(owner: Env | Setting) -> None:
    """Raise an InputError that names a field of `owner` whose value has no hash, by which jax looks up a program."""
    for field in dataclasses.fields(owner):
        value = getattr(owner, field.name)
        try:
            hash(value)
        except TypeError:
            raise InputError(f"{owner.name}: {field.name} must be a plain value, not {brief(value)}") from None


def _taken(options: dict[str, Any], owner: Any) -> dict[str, Any]:
    """Remove the fields of the dataclass `owner` from `options`, and return them."""
    fields = {field.name for field in dataclasses.fields(owner)}
    return {name: options.pop(name) for name in list(options) if name in fields}
