"""Variants of the kitchen and of FBRL for difference 13, with `--import benchmarks/paper/kitchen_variants.py`.

Their policies have log standard deviations up to 10, as the release clips them.
"""

import dataclasses
from typing import Any, ClassVar

import jax
import numpy as np

import earl_jax
from earl_jax.algos.fbrl import FBRL
from earl_jax.algos.learner import networks
from earl_jax.algos.method import Moment
from earl_jax.envs import Env
from earl_jax.envs.features import Starts
from earl_jax.envs.kitchen.franka_kitchen import CLOSED, FrankaKitchen
from earl_jax.envs.state import State

networks.LOG_STD_RANGE = (-20.0, 10.0)


@dataclasses.dataclass(frozen=True)
class MeanReturnKitchen(FrankaKitchen):
    """The kitchen for methods that return to the mean of its six initial states, with four appliances half open.

    The goal of the backward agent in VaPRL's released script is this mean. Episodes start as in the kitchen.
    """

    name: ClassVar[str] = "mean_return_kitchen"

    @property
    def model(self) -> str:
        return FrankaKitchen.name

    @property
    def initial_states(self) -> np.ndarray:
        return self._kitchen.initial_states.mean(axis=0, keepdims=True)

    def reset(self, key: jax.Array) -> State:
        return self._kitchen.reset(key)

    @property
    def starts(self) -> Starts:
        return self._kitchen.starts

    @property
    def _kitchen(self) -> FrankaKitchen:
        return FrankaKitchen(**dataclasses.asdict(self))


@dataclasses.dataclass(frozen=True)
class ClosedReturnKitchen(MeanReturnKitchen):
    """The kitchen for methods that return to its goal, as VaPRL's released kitchen has its initial state."""

    name: ClassVar[str] = "closed_return_kitchen"

    @property
    def initial_states(self) -> np.ndarray:
        return CLOSED[None].copy()


class SuccessFBRL(FBRL):
    """FBRL whose phases end on success with a dense reward too, a step later than those of a sparse task."""

    name: ClassVar[str] = "success_fbrl"

    def ends_phase(
        self, key: jax.Array, env: Env, agent: Any, obs: jax.Array, moment: Moment, method_state: Any
    ) -> jax.Array:
        return env.success(obs) | super().ends_phase(key, env, agent, obs, moment, method_state)


for variant in (MeanReturnKitchen, ClosedReturnKitchen):
    earl_jax.register_env(variant.name, variant)
earl_jax.register_algo(SuccessFBRL.name, SuccessFBRL)
