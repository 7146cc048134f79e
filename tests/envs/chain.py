"""A task small enough to know every answer by hand."""

import dataclasses
from typing import ClassVar

import jax.numpy as jnp
import numpy as np

from earl_jax.envs import KinematicEnv


@dataclasses.dataclass(frozen=True)
class Chain(KinematicEnv):
    """Positions 0 to `cliff`, which is irreversible; a positive action moves right, any other left.

    A `fragile` chain breaks when it moves left at 0.
    """

    cliff: int = 4
    start: int = 0
    goal: int = 3
    fragile: bool = False

    name: ClassVar[str] = "chain"
    action_size: ClassVar[int] = 1
    state_size: ClassVar[int] = 1

    @property
    def goal_states(self):
        return np.array([[self.goal], [0.0]], np.float32)

    @property
    def initial_states(self):
        return np.array([[self.start]], np.float32)

    def state_at(self, position, goal):
        """Return the state at `position []` with the goal `goal [1]`."""
        vector = jnp.full(1, position, jnp.float32)
        return self.make_state(vector, vector, {"goal": jnp.asarray(goal)})

    def reset(self, key):
        return self.state_at(self.start, self.sample_goal(key))

    def transition(self, state, action):
        moved = state.data + jnp.where(action > 0, 1.0, -1.0)
        moved = jnp.where(self.fragile & (moved < 0), jnp.nan, jnp.clip(moved, 0.0, self.cliff))
        return moved, moved, {}

    def success(self, obs):
        return jnp.abs(obs[..., 0] - obs[..., 1]) < 0.5

    def reward(self, obs):
        return self.success(obs).astype(jnp.float32) if self.sparse else -jnp.abs(obs[..., 0] - obs[..., 1])

    def irreversible(self, state):
        return state.data[0] >= self.cliff
