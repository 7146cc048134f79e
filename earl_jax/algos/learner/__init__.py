"""The registry of learners, with their networks and their replay. Other packages use `register_learner`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from earl_jax.options.registry import Registry

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

    from earl_jax.algos.learner.base import Learner

DEFAULT = "sac"
_LEARNERS = Registry(
    "learner",
    {"sac": "earl_jax.algos.learner.sac:SAC", "td3": "earl_jax.algos.learner.td3:TD3"},
)


def list_learners() -> list[str]:
    """Return the names of the learners, sorted."""
    return _LEARNERS.names()


def register_learner(name: str, learner: type[Learner]) -> None:
    """Register `learner`, a `Learner` subclass, as `name` for `make_algo(..., learner=name)`.

    Raises:
        ValueError: the name is taken.
    """
    _LEARNERS.register(name, learner)


def locate_learner(name: str) -> tuple[EntryPoint | type, str]:
    """Return where the class of the learner `name` is, and the package that brings it, as `Registry.locate`."""
    return _LEARNERS.locate(name)


def learner_class(name: str) -> type[Learner]:
    """Return the class of the learner `name`.

    Raises:
        ValueError: the name is unknown or cannot be loaded; the message gives the cause or the choices.
    """
    return _LEARNERS.get(name)


def make_learner(name: str = DEFAULT, **options: Any) -> Learner:
    """Return the learner `name` with these options.

    Raises:
        ValueError: the name or an option is unknown; the message lists the choices.
    """
    return _LEARNERS.build(name, options)
