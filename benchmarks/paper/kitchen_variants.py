"""A variant of the kitchen for difference 13, with `--import benchmarks/paper/kitchen_variants.py`."""

import dataclasses
from typing import ClassVar

import jax
import numpy as np

import earl_jax
from earl_jax.envs.features import Starts
from earl_jax.envs.kitchen.franka_kitchen import FrankaKitchen
from earl_jax.envs.state import State


@dataclasses.dataclass(frozen=True)
class MeanReturnKitchen(FrankaKitchen):
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


earl_jax.register_env(MeanReturnKitchen.name, MeanReturnKitchen)
