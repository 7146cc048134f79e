"""The registry of methods. To add one, add a file and a line to the table below; other packages use `register_algo`.

The classes are loaded on first use, so that the names can be listed without jax.
"""

from __future__ import annotations

import dataclasses
import importlib
from typing import TYPE_CHECKING, Any

from earl_jax.errors import InputError
from earl_jax.options.registry import Registry

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

    from earl_jax.algos.learner.sac import SAC
    from earl_jax.algos.method import Method
    from earl_jax.envs import Env

__all__ = ["SAC", "Method", "algo_class", "list_algos", "locate_algo", "make_algo", "method_for", "register_algo"]

_HOME = {"Method": "method", "SAC": "learner.sac"}
_ALGOS = Registry(
    "algo",
    {
        "bc": "earl_jax.algos.bc:BC",
        "cfbrl": "earl_jax.algos.cfbrl:CFBRL",
        "fbrl": "earl_jax.algos.fbrl:FBRL",
        "medal": "earl_jax.algos.medal:MEDAL",
        "naive": "earl_jax.algos.naive:Naive",
        "oracle": "earl_jax.algos.oracle:Oracle",
        "r3l": "earl_jax.algos.r3l:R3L",
        "risc": "earl_jax.algos.risc:RISC",
        "rlpd": "earl_jax.algos.rlpd:RLPD",
        "vaprl": "earl_jax.algos.vaprl:VaPRL",
    },
)


def list_algos() -> list[str]:
    """Return the names that `make_algo` takes, sorted."""
    return _ALGOS.names()


def register_algo(name: str, method: type[Method]) -> None:
    """Register `method`, a `Method` subclass, as `name` for `make_algo`.

    Raises:
        ValueError: the name is taken.
    """
    _ALGOS.register(name, method)


def locate_algo(name: str) -> tuple[EntryPoint | type, str]:
    """Return where the class of the method `name` is, and the package that brings it, as `Registry.locate`."""
    return _ALGOS.locate(name)


def algo_class(name: str) -> type[Method]:
    """Return the class of the method `name`.

    Raises:
        ValueError: the name is unknown or cannot be loaded; the message gives the cause or the choices.
    """
    return _ALGOS.get(name)


def make_algo(name: str, **options) -> Method:
    """Return the method `name`; options are its own fields and those of `SAC`, whose defaults the method can replace.

    A float field also takes a list with a value for each lane: `make_algo("vaprl", reward_scale=[1.0, 10.0])` for two
    lanes.

    Raises:
        ValueError: the name or an option is unknown; the message lists the choices.
    """
    from earl_jax.algos.learner.sac import SAC
    from earl_jax.options.values import check

    shared = {field.name for field in dataclasses.fields(SAC)}
    own = {field.name for field in dataclasses.fields(_ALGOS.get(name))} - {"sac"}
    unknown = sorted(set(options) - shared - own)
    if unknown:
        raise InputError(f"algo {name!r} has no option {unknown[0]!r}; choose from {', '.join(sorted(shared | own))}")
    options = {option: _leaf(option, value) for option, value in options.items()}
    learner = {option: value for option, value in options.items() if option in shared}
    check(f"algo {name!r}", SAC, learner)
    sac = _ALGOS.get(name).sac.replace(**learner)
    return _ALGOS.build(name, {"sac": sac, **{option: value for option, value in options.items() if option in own}})


def method_for(env: Env, name: str, **options) -> Method:
    """Return `make_algo(name, **options)`, by default with the reward scale of `env`.

    Raises:
        ValueError: as `make_algo`.
    """
    return make_algo(name, **{"reward_scale": env.reward_scale, **options})


def _leaf(option: str, value: Any) -> Any:
    """Return `value` in the type of its field; a JSON or CLI list is layer sizes or one value per lane."""
    if not isinstance(value, list | tuple):
        return value
    if option == "hidden_sizes":
        return tuple(value)
    import numpy as np

    try:
        with np.errstate(over="ignore"):  # too large values become infinite, and the check of intervals refuses them
            return np.asarray(value, np.float32)
    except (TypeError, ValueError) as error:
        raise InputError(f"{option} must be a number for each lane, not {value!r}") from error


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
