"""Naive RL: one endless episode with a biased TD update every 1000 steps."""

from typing import Any, ClassVar

import jax
from flax import struct

from earl_jax.algos.method import Method, Moment, Phase
from earl_jax.envs import Env
from earl_jax.options.values import COUNT, within


class Naive(Method):
    """Pursue one task goal after another, without a reset.

    Keep the task goal until it is reached or `episode_length` steps have passed; then draw the next one, without reset.

    Source: Sharma et al. 2022, section 6.1. The text does not say that success also draws a new goal, but the published
    reward rate of one reward in 30.7 steps on tabletop requires it.
    """

    episode_length: int = struct.field(pytree_node=False, default=1000, metadata=within(COUNT))
    """Steps after which a goal that was not reached is given up, with the biased TD update (released flags: 400)."""

    global_clock: bool = struct.field(pytree_node=False, default=False)
    """Whether goals are given up when the step of the lifetime is a multiple of `episode_length`, as section 6.1 says,
    instead of `episode_length` steps after the goal was drawn."""

    name: ClassVar[str] = "naive"

    @property
    def phases(self) -> tuple[Phase, ...]:
        return (Phase(length=self.episode_length),)

    def ends_phase(
        self, key: jax.Array, env: Env, agent: Any, obs: jax.Array, moment: Moment, method_state: Any
    ) -> jax.Array:
        age = moment.step % self.episode_length if self.global_clock else moment.phase_step
        return age + 1 >= self.episode_length
