"""Fish swim: bring the mouth to a target in the water, the DeepMind Control Suite's `fish-swim` with goals.

Source: dm_control 1.0.50, `suite/fish`. The model is our own MJCF with the suite's numbers.
"""

import dataclasses
import itertools
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.envs.features import ContinuingDefaults, Map
from earl_jax.envs.mujoco_env import MujocoEnv
from earl_jax.envs.shaping import tolerance
from earl_jax.envs.state import NextState, State
from earl_jax.physics import EngineCost, PhysicsState

JOINTS = 7
ROOT = 7
"""Index of the first joint in MuJoCo's qpos, after the trunk's position and quaternion."""
START = np.array([0.0, 0.0, 0.1], np.float32)
"""The trunk's position after a reset, metres."""
MOUTH = 0.0745
"""Metres from the trunk's middle forward to the mouth."""
RADIUS = 0.045
"""Distance in metres between mouth and target within which the target is reached: the sum of their radii."""
BEND = 0.2
"""Half-width in radians of the uniform joint angles of a start."""
TURN = 2 * np.pi
"""Joint angle in radians beyond which the simulation broke; servos and springs hold the joints within 1.4."""
TARGETS = np.stack(np.meshgrid(np.linspace(-0.4, 0.4, 9), np.linspace(-0.4, 0.4, 9), np.linspace(0.1, 0.3, 5)), axis=-1)
"""The grid of targets over the suite's box, with steps of 10 cm across and 5 cm up: no position in the box is further
than 7.5 cm from a target."""


@dataclasses.dataclass(frozen=True)
class FishSwim(MujocoEnv):
    """A fish swims to a target (the paper's figure 2).

    `obs [36]` = state 33, target 3; `action [5]` = tail, tail twist, flap, left, right fin pitch.
    State: joint angles 7, uprightness 1, velocities 13, the mouth's position 3 and frame 9 (a matrix, row by row). The
    suite observes the target in the mouth's frame instead: `target_seen`. Its targets are uniform in a box. Ours are
    405 grid points of that box, because the replay stores goals as indices. The suite defines no success; here it is a
    tolerance of 1.
    """

    reward_type: str = "dense"
    train_horizon: int = 100_000
    eval_horizon: int = 1000
    substeps: int = 10

    name: ClassVar[str] = "fish_swim"
    engine_cost: ClassVar[EngineCost | None] = EngineCost(host=0.098)
    state_size: ClassVar[int] = 33
    action_size: ClassVar[int] = 5
    goal_states: ClassVar[np.ndarray] = TARGETS.reshape(-1, 3).astype(np.float32)
    continuing: ClassVar[ContinuingDefaults] = ContinuingDefaults(1000)
    control_step: ClassVar[float] = 0.04

    @property
    def initial_states(self) -> np.ndarray:
        """Positions of the mouth at a start, float32 [26, 3], all around the trunk: a start can face anywhere."""
        directions = np.array([step for step in itertools.product((-1, 0, 1), repeat=3) if any(step)], np.float32)
        return START + np.float32(MOUTH) * directions / np.linalg.norm(directions, axis=1, keepdims=True)

    def reset(self, key: jax.Array) -> State:
        goal_key, turn_key, bend_key = jax.random.split(key, 3)
        quat, goal = jax.random.normal(turn_key, (4,)), self.sample_goal(goal_key)
        bent = jax.random.uniform(bend_key, (JOINTS,), minval=-BEND, maxval=BEND)
        qpos = jnp.concatenate([jnp.asarray(START), quat / jnp.linalg.norm(quat), bent])
        data = PhysicsState.at(
            qpos, jnp.zeros(6 + JOINTS), mocap_pos=goal[None], mocap_quat=jnp.array([[1.0, 0, 0, 0]])
        )
        return self.make_state(data, _observed(data), {"goal": goal})

    def control(self, state: State, action: jax.Array) -> tuple[PhysicsState, jax.Array]:
        return self._at_goal(state), action

    def observe(self, state: State, action: jax.Array, data: PhysicsState, sensors: jax.Array) -> NextState:
        return data, _observed(data), {}

    def _at_goal(self, state: State) -> PhysicsState:
        return state.data.replace(mocap_pos=state.info["goal"][None])

    @property
    def map(self) -> Map:
        """The mouth's positions. The bounds are more than twice the targets' box, and a fish may leave them."""
        return Map(position=lambda obs: obs[..., 21:23], bounds=np.array([[-1.0, -1.0], [1.0, 1.0]], np.float32))

    def fault(self, state: State) -> jax.Array:
        return super().fault(state) | (jnp.abs(state.obs[:JOINTS]) > TURN).any()

    def target_seen(self, obs: jax.Array) -> jax.Array:
        """Return the vector [..., 3] from mouth to target in `obs [..., 36]`, metres, in the mouth's frame.

        This is the suite's `target`. The frame is MuJoCo's for the mouth: x to the fish's right, y down, z ahead.
        """
        frame = obs[..., 24:33].reshape(*obs.shape[:-1], 3, 3)
        return jnp.einsum("...w,...wm->...m", obs[..., 33:36] - obs[..., 21:24], frame, precision="highest")

    def to_target(self, obs: jax.Array) -> jax.Array:
        """Return the mouth's distance [...] to the target in `obs [..., 36]`, metres."""
        return jnp.linalg.norm(obs[..., 33:36] - obs[..., 21:24], axis=-1)

    def success(self, obs: jax.Array) -> jax.Array:
        return self.to_target(obs) <= RADIUS

    def reward(self, obs: jax.Array) -> jax.Array:
        if self.sparse:
            return self.success(obs).astype(jnp.float32)
        reached = tolerance(self.to_target(obs), 0.0, RADIUS, jnp.asarray(2 * RADIUS))
        return (7.0 * reached + 0.5 * (obs[..., JOINTS] + 1.0)) / 8.0


def _observed(data: PhysicsState) -> jax.Array:
    """Return the state [33] of `data`."""
    w, x, y, z = data.qpos[3:ROOT] / jnp.linalg.norm(data.qpos[3:ROOT])
    right = jnp.stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)])
    ahead = jnp.stack([2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)])
    up = jnp.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
    frame = jnp.stack([right, -up, ahead], axis=1)
    return jnp.concatenate([data.qpos[ROOT:], up[2:], data.qvel, data.qpos[:3] + MOUTH * ahead, frame.ravel()])
