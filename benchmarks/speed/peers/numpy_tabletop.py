"""Tabletop organization as a gymnasium env of plain NumPy: the arithmetic of `earl_jax.envs.tabletop`, one step at a time."""

from typing import Any

import gymnasium
import numpy as np

from earl_jax.envs.tabletop import COASTERS, FREE, HELD, HOME, LIMIT, REACH, STEP, TOLERANCE


class NumpyTabletop(gymnasium.Env):
    """`obs [12]` = gripper 2, mug 2, held flag 2, goal 6; `action [3]` = dx, dy, grip; reward 1 on success, which ends.

    Time is up after `horizon` steps. Returns float32 observations, as the JAX task does.
    """

    def __init__(self, horizon: int = 200):
        self.horizon = horizon
        self.observation_space = gymnasium.spaces.Box(-LIMIT, LIMIT, (12,), np.float32)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (3,), np.float32)
        self.positions, self.held, self.goal, self.time = HOME.copy(), False, np.zeros(6, np.float32), 0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict]:
        super().reset(seed=seed)
        self.positions, self.held, self.time = HOME.copy(), False, 0
        coaster = COASTERS[self.np_random.integers(len(COASTERS))]
        self.goal = np.concatenate([HOME[:2], coaster, FREE])
        return self._obs(), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict]:
        action = np.clip(action, -1.0, 1.0)
        gripper, mug = self.positions[:2], self.positions[2:]
        near = np.hypot(*(gripper - mug)) < REACH
        self.held = bool(action[2] > 0 and (near or self.held))
        moved = np.clip(gripper + STEP * action[:2], -LIMIT, LIMIT)
        carried = np.clip(mug + (moved - gripper), -LIMIT, LIMIT) if self.held else mug
        self.positions = np.concatenate([moved, carried])
        self.time += 1
        success = bool(np.linalg.norm(self.positions - self.goal[:4]) <= TOLERANCE)
        return self._obs(), float(success), success, self.time >= self.horizon, {}

    def _obs(self) -> np.ndarray:
        flag = HELD if self.held else FREE
        return np.concatenate([self.positions, flag, self.goal]).astype(np.float32)
