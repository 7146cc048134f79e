"""R3L that also reports the mean environment reward of the task controller's replay, for difference 34.

earl-jax train franka_kitchen --algo phase_reward_r3l --import benchmarks/paper/phase_rewards.py
"""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp

import benchmarks.paper.released_fbrl  # noqa: F401  (the release's upper bound of the log standard deviations)
import earl_jax
from earl_jax.algos.method import RETURN
from earl_jax.algos.r3l import R3L, RND

DECAY = 0.999
"""Decay of the running mean over the task controller's updates."""


class WithReward(RND):
    """RND with the running mean reward of the task controller's batches."""

    reward: jax.Array

    @property
    def metrics(self) -> dict[str, jax.Array]:
        return {"task_reward": self.reward}


class PhaseRewardR3L(R3L):
    """R3L that reports the mean reward of the steps of the task controller alone."""

    name: ClassVar[str] = "phase_reward_r3l"

    def init(self, key, env, goals) -> WithReward:
        rnd = super().init(key, env, goals)
        return WithReward(rnd.target, rnd.predictor, rnd.moments, rnd.sigma, jnp.zeros(()))

    def learn(self, key, env, agent, batch, phase, method_state) -> tuple[Any, WithReward, dict[str, jax.Array]]:
        agent, state, diagnostics = super().learn(key, env, agent, batch, phase, method_state)
        mean = DECAY * state.reward + (1 - DECAY) * batch.reward.mean()
        return agent, state.replace(reward=jnp.where(phase == RETURN, state.reward, mean)), diagnostics


earl_jax.register_algo(PhaseRewardR3L.name, PhaseRewardR3L)
