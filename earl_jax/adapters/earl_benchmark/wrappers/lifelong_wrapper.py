"""The wrapper that changes the goal on a schedule and adds up the reward of the whole life."""

from typing import Any

import numpy as np

from earl_jax.adapters.earl_benchmark.wrappers import Wrapper


class LifelongWrapper(Wrapper):
    """An env with a new task goal every `goal_change_frequency` steps.

    It counts `num_interventions` and adds up rewards in `lifelong_return`. `reset_goal` of the wrapped env must return
    the observation with the new goal.
    """

    def __init__(self, env: Any, goal_change_frequency: int):
        super().__init__(env)
        self.lifelong_return = 0.0
        self._frequency = goal_change_frequency

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, dict]:
        """Return observation, reward, done and info; the reward is for the old goal, the observation has the new."""
        obs, reward, done, info = self.env.step(action)
        self.lifelong_return += reward
        self._steps += 1
        if self._steps >= self._frequency:
            self._steps = 0
            obs = self.env.reset_goal()
        return obs, reward, done, info
