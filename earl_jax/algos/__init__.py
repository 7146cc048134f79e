"""Methods. To add one, add a file and a line to the table of `options.registry`; other packages use `register_algo`."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from earl_jax.algos.learner.base import Learner as Learner
from earl_jax.algos.learner.sac import SAC as SAC
from earl_jax.algos.learner.td3 import TD3 as TD3
from earl_jax.algos.method import Method as Method, Phase as Phase
from earl_jax.envs import Env
from earl_jax.errors import InputError, brief
from earl_jax.options.registry import ALGOS, LEARNER, LEARNERS
from earl_jax.options.schedule import FIELDS
from earl_jax.options.values import check, require_object

list_algos = ALGOS.names
"""`list_algos()` returns the names that `make_algo` accepts, sorted."""
register_algo = ALGOS.register
"""`register_algo(name, cls)` registers the `Method` subclass `cls` for `make_algo`. A taken name is a ValueError."""
list_learners = LEARNERS.names
"""`list_learners()` returns the names of the learners, sorted."""
register_learner = LEARNERS.register
"""`register_learner(name, cls)` registers the `Learner` subclass `cls`. A name that is taken raises a ValueError."""


def make_algo(name: str, *, learner: str | Learner | None = None, **options) -> Method:
    """Return the method `name`; `options` are fields of the method and of its learner.

    A float field also accepts a list with a value for each lane: `make_algo("vaprl", reward_scale=[1.0, 10.0])` for two
    lanes. `learner` is a name of `list_learners()` or a `Learner`, to which the options apply, too; by default `sac`.

    Raises:
        ValueError: the name or an option is unknown; the message lists the choices or the most similar names.
    """
    method = ALGOS.get(name)
    base = method.learner if learner is None else learner
    require_object("learner", base, Learner)
    if isinstance(base, str):
        base = preset_learner(method, LEARNERS.get(base))
    of_learner = {field.name: field for field in dataclasses.fields(base)}
    of_method = {field.name: field for field in dataclasses.fields(method) if field.name != "learner"}
    known = of_method | of_learner
    for option, value in options.items():
        if option not in known:
            names = [*sorted({*known, "learner"}), *FIELDS]
            raise _unknown_option(name, option, value, names, None if learner is None else base.name)
    options = {option: _leaf(known[option], value) for option, value in options.items()}
    learner_options = {option: value for option, value in options.items() if option in of_learner}
    method_options = {option: value for option, value in options.items() if option in of_method}
    check(f"method {name!r}", type(base), learner_options)
    return ALGOS.make(name, learner=base.replace(**learner_options), **method_options)


def _unknown_option(name: str, option: str, value: Any, known: Sequence[str], learner: str | None) -> InputError:
    """Return the error for an `option` that the method `name` lacks: a fix, or similar `known` names and where to look.

    Names that are `known` but not options belong to the schedule. `learner` is the name of a learner that was chosen.
    """
    from difflib import get_close_matches

    owner, one = f"method {name!r}", brief(value)
    if learner and option in {field.name for field in dataclasses.fields(SAC)}:
        return InputError(
            f"{owner} has no option {option!r} with the learner {learner!r}: leave it out, or the preset with it"
        )
    if option == "seeds" or option in known:
        flag = option.replace("_", "-")
        return InputError(
            f"{owner} has no option {option!r}; it stands beside the options: {option}={one}, or --{flag} {one}"
        )
    if option in ("seed", "n_seeds", "num_seeds"):
        alone = f" (or seeds=[{one}] for that seed alone)" if option == "seed" else ""
        return InputError(f"there is no option {option!r}; did you mean seeds={one}{alone}?")
    near = get_close_matches(option, known, 3)
    guess = f"did you mean {' or '.join(near)}? " if near else ""
    lists = f"`earl-jax list {name}` lists its options, `earl-jax list TASK` those of a task"
    return InputError(f"{owner} has no option {option!r}; {guess}{lists}")


def learner_of(options: dict[str, Any]) -> Learner:
    """Return the learner that the options of a method describe, without the method's own defaults.

    With it, policies of a run can be evaluated without the class of the method.
    """
    name = options.get("learner", LEARNER)
    fields = {field.name: field for field in dataclasses.fields(LEARNERS.get(name))}
    own = {option: _leaf(fields[option], value) for option, value in options.items() if option in fields}
    return LEARNERS.make(name, **own)


def preset_learner(method: type[Method], learner: type[Learner]) -> Learner:
    """Return a `learner` with the defaults of `method`; if its own learner has another class, only the shared ones."""
    preset = method.learner
    if type(preset) is learner:
        return preset
    return learner(**{field.name: getattr(preset, field.name) for field in dataclasses.fields(Learner)})


def method_for(env: Env, name: str, **options) -> Method:
    """Return `make_algo(name, **options)` with the reward scale of `env`, unless options, the method or a learner set it.

    Raises:
        ValueError: as in `make_algo`, or `env` is a name instead of a task.
    """
    require_object("task", env, Env, or_name=False)
    learner = options.get("learner")
    if has_default_scale(learner if isinstance(learner, Learner) else ALGOS.get(name).learner):
        options.setdefault("reward_scale", env.reward_scale)
    return make_algo(name, **options)


def has_default_scale(learner: Learner) -> bool:
    """Return whether the reward scale of `learner` is its class's default in all lanes."""
    return bool(np.all(learner.reward_scale == type(learner).reward_scale))


def _leaf(field: dataclasses.Field, value: Any) -> Any:
    """Return `value` as `field` stores it: a list gives a value for each lane, or a static option such as sizes."""
    is_static = not field.metadata.get("pytree_node", True)
    if is_static and isinstance(value, np.ndarray):
        value = value.tolist()
    if not isinstance(value, list | tuple):
        return value
    if is_static:
        return tuple(value)
    try:
        with np.errstate(over="ignore"):  # too large values become infinite, and the check of intervals refuses them
            return np.asarray(value, np.float32)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{field.name} must be a number for each lane, not {brief(value)}") from error
