"""The registry of learners, with their networks and their replay. Other packages use `register_learner`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from earl_jax.options.registry import Registry

if TYPE_CHECKING:
    from earl_jax.algos.learner.base import Learner

DEFAULT = "sac"
_LEARNERS: Registry[Learner] = Registry(
    "learner",
    {"sac": "earl_jax.algos.learner.sac:SAC", "td3": "earl_jax.algos.learner.td3:TD3"},
)
list_learners = _LEARNERS.names
register_learner = _LEARNERS.register
locate_learner = _LEARNERS.locate
learner_class = _LEARNERS.get
make_learner = _LEARNERS.make
