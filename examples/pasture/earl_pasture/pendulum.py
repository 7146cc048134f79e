"""A motor turns a pendulum to one of two angles, and back to rest between two attempts."""

import dataclasses
from pathlib import Path
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.envs import MujocoEnv, State, TaskDemos
from earl_jax.envs.state import NextState
from earl_jax.physics import PhysicsState

GOALS = np.array([[-1.0, 0.0], [1.0, 0.0]], np.float32)  # rad, rad/s
TOLERANCE = np.array([0.1, 0.5], np.float32)  # rad, rad/s
MAX_TORQUE = 2.0  # N m, the motor's gear in pendulum.xml
GRAVITY_TORQUE = 9.81 * (0.1 * 0.25 + 0.2 * 0.5)  # N m of rod and bob at 90 degrees
MAX_VELOCITY = 50.0  # rad/s that a sound simulation never reaches


@dataclasses.dataclass(frozen=True)
class PendulumHold(MujocoEnv):
    """A pendulum with a motor: `obs [4]` = angle, velocity, goal 2; `action [1]` = torque.

    The angle is in radians, 0 at rest; the torque is 2 N m at 1. Success: within 0.1 rad and
    0.5 rad/s of the goal.
    """

    train_horizon: int = 20_000
    eval_horizon: int = 100
    substeps: int = 2

    name: ClassVar[str] = "pendulum_hold"
    state_size: ClassVar[int] = 2
    action_size: ClassVar[int] = 1
    control_step: ClassVar[float] = 0.04

    @property
    def model(self) -> str:
        return str(Path(__file__).with_name("pendulum.xml"))

    @property
    def goal_states(self) -> np.ndarray:
        return GOALS

    @property
    def initial_states(self) -> np.ndarray:
        return np.zeros((1, 2), np.float32)

    def reset(self, key: jax.Array) -> State:
        angle_key, goal_key = jax.random.split(key)
        data = PhysicsState.at(jax.random.uniform(angle_key, (1,), minval=-0.1, maxval=0.1))
        return self.make_state(data, state_vector(data), {"goal": self.sample_goal(goal_key)})

    def control(self, state: State, action: jax.Array) -> tuple[PhysicsState, jax.Array]:
        return state.data, action

    def observe(self, state: State, action: jax.Array, data: PhysicsState, sensors: jax.Array) -> NextState:
        return data, state_vector(data), {}

    def success(self, obs: jax.Array) -> jax.Array:
        return (jnp.abs(obs[..., :2] - obs[..., 2:]) <= TOLERANCE).all(axis=-1)

    def reward(self, obs: jax.Array) -> jax.Array:
        if self.sparse:
            return self.success(obs).astype(jnp.float32)
        angle_error, velocity_error = jnp.moveaxis(jnp.abs(obs[..., :2] - obs[..., 2:]), -1, 0)
        return -angle_error - 0.1 * velocity_error

    def fault(self, state: State) -> jax.Array:
        return super().fault(state) | (jnp.abs(state.data.qvel) > MAX_VELOCITY).any()

    @property
    def demonstrations(self) -> TaskDemos:
        return dataclasses.replace(super().demonstrations, expert=self._expert)

    def _expert(self, obs: jax.Array) -> jax.Array:
        """Return the action [1] of a PD controller with gravity compensation."""
        torque = 4.0 * (obs[2] - obs[0]) - 0.8 * obs[1] + GRAVITY_TORQUE * jnp.sin(obs[0])
        return jnp.clip(torque / MAX_TORQUE, -1.0, 1.0)[None]


def state_vector(data: PhysicsState) -> jax.Array:
    """Return the state [2] of `data`: angle and velocity."""
    return jnp.concatenate([data.qpos, data.qvel])
