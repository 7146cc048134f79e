"""A dog drives a sheep into a corner of a pasture, and out again between two attempts."""

import dataclasses
from collections.abc import Iterator
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.envs import DemoScript, DemoStart, KinematicEnv, State, TaskDemos
from earl_jax.envs.state import NextState

STEP = 0.1
FENCE = 1.0  # limits the sheep
DOG_LIMIT = 1.5  # the dog can jump the fence, to get behind a sheep that stands at it
TOLERANCE = 0.2
START = np.array([0.0, -0.9, 0.0, -0.3], np.float32)
CORNERS = np.array([[-0.8, 0.8], [0.8, 0.8]], np.float32)


def unit(vector: jax.Array) -> jax.Array:
    """Return `vector [2]` at length 1."""
    return vector / jnp.maximum(jnp.linalg.norm(vector), 1e-6)


@dataclasses.dataclass(frozen=True)
class Pasture(KinematicEnv):
    """Dog and sheep on a plane: `obs [8]` = dog 2, sheep 2, goal 4; `action [2]` moves the dog.

    An action of 1 moves the dog by 0.1 on that axis. The sheep keeps a distance of `fear` from the
    dog. Success: the sheep is within 0.2 of its goal; the dog may be anywhere.
    """

    train_horizon: int = 20_000
    eval_horizon: int = 100
    fear: float = 0.5

    name: ClassVar[str] = "pasture"
    state_size: ClassVar[int] = 4
    action_size: ClassVar[int] = 2

    @property
    def goal_states(self) -> np.ndarray:
        return np.concatenate([0.5 * CORNERS, CORNERS], axis=1)

    @property
    def initial_states(self) -> np.ndarray:
        return START[None]

    def reset(self, key: jax.Array) -> State:
        start_key, goal_key = jax.random.split(key)
        noise = jax.random.uniform(start_key, (4,), minval=-0.05, maxval=0.05)
        positions = jnp.asarray(START) + noise
        return self.make_state(positions, positions, {"goal": self.sample_goal(goal_key)})

    def transition(self, state: State, action: jax.Array) -> NextState:
        dog = jnp.clip(state.data[:2] + STEP * action, -DOG_LIMIT, DOG_LIMIT)
        away = state.data[2:] - dog
        retreat = jnp.maximum(self.fear - jnp.linalg.norm(away), 0.0)
        sheep = jnp.clip(state.data[2:] + retreat * unit(away), -FENCE, FENCE)
        positions = jnp.concatenate([dog, sheep])
        return positions, positions, {}

    def success(self, obs: jax.Array) -> jax.Array:
        return jnp.linalg.norm(obs[..., 2:4] - obs[..., 6:8], axis=-1) <= TOLERANCE

    def reward(self, obs: jax.Array) -> jax.Array:
        if self.sparse:
            return self.success(obs).astype(jnp.float32)
        to_goal, to_sheep = obs[..., 2:4] - obs[..., 6:8], obs[..., :2] - obs[..., 2:4]
        return -jnp.linalg.norm(to_goal, axis=-1) - 0.5 * jnp.linalg.norm(to_sheep, axis=-1)

    @property
    def demonstrations(self) -> TaskDemos:
        script = DemoScript(noise=0.1, starts=self._demo_starts)
        return dataclasses.replace(super().demonstrations, expert=self._expert, script=script)

    def _expert(self, obs: jax.Array) -> jax.Array:
        """Return the action [2] that circles to the far side of the sheep, then walks at it."""
        dog, sheep, direction = obs[:2], obs[2:4], unit(obs[6:8] - obs[2:4])
        side = unit(dog - sheep)
        turn = jnp.sign(direction[0] * side[1] - direction[1] * side[0])
        aside = sheep + 1.5 * self.fear * unit(side + 0.5 * turn * jnp.stack([-side[1], side[0]]))
        behind = side @ direction < -0.95
        target = jnp.where(behind, sheep - 0.7 * self.fear * direction, aside)
        return jnp.clip((target - dog) / STEP, -1.0, 1.0)

    def _demo_starts(self, seed: int) -> Iterator[DemoStart]:
        """Yield ten starts; a backward demonstration starts where its forward one ended."""
        for key in jax.random.split(jax.random.key(seed), 10):
            home = self.initial_states[0]
            yield DemoStart(forward=self.reset(key), backward=None, backward_goal=home)
