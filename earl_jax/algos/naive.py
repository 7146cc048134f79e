"""Naive RL: SAC in one endless episode, with the biased TD update every 1000 steps."""

from typing import ClassVar

import jax

from earl_jax.algos.method import Method
from earl_jax.envs import Env

BIASED_TD_STEPS = 1000


class Naive(Method):
    """Keep the task goal until it is reached or 1000 steps have passed, then draw the next one without a reset.

    Source: Sharma et al. 2022, section 5.1. The text does not say that success also draws a new goal, but the published
    reward rate of one reward in 30.7 steps on tabletop requires it.
    """

    name: ClassVar[str] = "naive"

    def phase_length(self, env: Env, phase: jax.Array) -> int:
        return BIASED_TD_STEPS
