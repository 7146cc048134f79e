"""The wrapper that says when a reset is due, but never resets by itself."""

from typing import Any

import numpy as np

from earl_jax.adapters.earl_benchmark.wrappers import Wrapper


class PersistentStateWrapper(Wrapper):
    """An env that reports `done` once `episode_horizon` steps have passed since its reset (0: never), and goes on.

    It counts `num_interventions` and `total_steps`.
    """

    def __init__(self, env: Any, episode_horizon: int):
        super().__init__(env)
        self.total_steps = 0
        self._horizon = episode_horizon

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, dict]:
        """Return observation, reward, done and info of the wrapped env; `done` is also true if a reset is due."""
        obs, reward, done, info = self.env.step(action)
        self.total_steps += 1
        self._steps += 1
        return obs, reward, done or 0 < self._horizon <= self._steps, info
