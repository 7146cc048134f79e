"""Variants of the kitchen and of FBRL for difference 13, with `--import benchmarks/paper/kitchen_variants.py`."""

import dataclasses
from typing import Any, ClassVar

import jax
import numpy as np

import earl_jax
from earl_jax.algos.fbrl import FBRL
from earl_jax.algos.method import Moment
from earl_jax.algos.r3l import R3L
from earl_jax.envs import Env
from earl_jax.envs.features import Starts
from earl_jax.envs.kitchen.franka_kitchen import PAIRS, FrankaKitchen, with_open
from earl_jax.envs.state import State


class KitchenVariant(FrankaKitchen):
    """The kitchen with other initial states, to which methods return."""

    @property
    def model(self) -> str:
        return FrankaKitchen.name


@dataclasses.dataclass(frozen=True)
class MeanReturnKitchen(KitchenVariant):
    """The kitchen for methods that return to the mean of its six initial states, with four appliances half open.

    The goal of the backward agent in VaPRL's released script is this mean. Episodes start as in the kitchen.
    """

    name: ClassVar[str] = "mean_return_kitchen"

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
class OnePairKitchen(KitchenVariant):
    """The kitchen with one of its six initial states: resets and backward phases lead to `PAIRS[pair]`.

    The backward agent returns to the state where its life began. In the kitchen the goal of each backward phase is one of
    the six. This variant was chosen after a look at the released lives.
    """

    pair: int = 0
    """Index into `PAIRS`."""

    name: ClassVar[str] = "one_pair_kitchen"

    @property
    def initial_states(self) -> np.ndarray:
        return with_open(PAIRS[self.pair : self.pair + 1])


class SuccessFBRL(FBRL):
    """FBRL whose phases end on success with a dense reward too, a step later than those of a sparse task.

    So do the phases of MEDAL's released script. This variant was chosen after a look at the released lives.
    """

    name: ClassVar[str] = "success_fbrl"

    def ends_phase(
        self, key: jax.Array, env: Env, agent: Any, obs: jax.Array, moment: Moment, method_state: Any
    ) -> jax.Array:
        return env.success(obs) | super().ends_phase(key, env, agent, obs, moment, method_state)


class BothFBRL(FBRL):
    """FBRL whose two controllers learn at every step, as in VaPRL's released script with two agents.

    This variant was chosen after a look at the released lives.
    """

    name: ClassVar[str] = "both_fbrl"
    all_learn: ClassVar[bool] = True


class BothSuccessFBRL(SuccessFBRL):
    """FBRL whose two controllers learn at every step, and whose phases end on success.

    This variant was chosen after a look at the released lives.
    """

    name: ClassVar[str] = "both_success_fbrl"
    all_learn: ClassVar[bool] = True


class BothR3L(R3L):
    """R3L whose two controllers learn at every step. This variant was chosen after a look at the released lives."""

    name: ClassVar[str] = "both_r3l"
    all_learn: ClassVar[bool] = True


for variant in (MeanReturnKitchen, OnePairKitchen):
    earl_jax.register_env(variant.name, variant)
for method in (SuccessFBRL, BothFBRL, BothSuccessFBRL, BothR3L):
    earl_jax.register_algo(method.name, method)
