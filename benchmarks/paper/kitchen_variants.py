"""A variant of the kitchen for difference 13, with `--import benchmarks/paper/kitchen_variants.py`."""

import dataclasses
from typing import ClassVar

import jax
import numpy as np

import earl_jax
from earl_jax.envs.features import Starts
from earl_jax.envs.kitchen.franka_kitchen import FINGER_REACH, FrankaKitchen, _target
from earl_jax.envs.state import State


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


earl_jax.register_env(MeanReturnKitchen.name, MeanReturnKitchen)


def dragged(state, action):
    """Return the physics state whose mocap body is at its target, however far from the hand, as in the original."""
    return state.data.replace(mocap_pos=_target(state, action)[None]), state.obs[:2] + FINGER_REACH * action[:2]


@dataclasses.dataclass(frozen=True)
class UnleashedKitchen(FrankaKitchen):
    """The kitchen without a leash on the mocap body; with `substeps=40`, the original's motion."""

    name: ClassVar[str] = "unleashed_kitchen"

    @property
    def model(self) -> str:
        return FrankaKitchen.name

    def control(self, state, action):
        return dragged(state, action)


@dataclasses.dataclass(frozen=True)
class UnleashedMeanKitchen(MeanReturnKitchen):
    """The kitchen without the leash, for methods that return to the mean of its initial states."""

    name: ClassVar[str] = "unleashed_mean_kitchen"

    def control(self, state, action):
        return dragged(state, action)


class GreedySAC(earl_jax.SAC):
    """SAC that lives by its greedy actions."""

    name: ClassVar[str] = "greedy_sac"

    def act(self, key, actor, obs):
        return self.greedy(actor, obs)


earl_jax.register_env(UnleashedKitchen.name, UnleashedKitchen)
earl_jax.register_env(UnleashedMeanKitchen.name, UnleashedMeanKitchen)
earl_jax.register_learner(GreedySAC.name, GreedySAC)
