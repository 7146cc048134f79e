"""The registry of learners, with their networks and their replay. Other packages use `register_learner`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from earl_jax.options.registry import Registry

if TYPE_CHECKING:
    from earl_jax.algos.learner.base import Learner

DEFAULT = "sac"
_LEARNERS: Registry[Learner] = Registry(
    "learner",
    "earl_jax.algos.learner.base:Learner",
    {"sac": "earl_jax.algos.learner.sac:SAC", "td3": "earl_jax.algos.learner.td3:TD3"},
)
list_learners = _LEARNERS.names
"""`list_learners()` returns the names of the learners, sorted."""
register_learner = _LEARNERS.register
"""`register_learner(name, cls)` registers the `Learner` subclass `cls`. A name that is taken is a ValueError."""
locate_learner = _LEARNERS.locate
learner_class = _LEARNERS.get
make_learner = _LEARNERS.make
