"""Sawyer door: close an open door by its handle; a reset-free agent must open it again itself."""

import dataclasses
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax import assets
from earl_jax.envs.features import ContinuingDefaults, Map, Starts
from earl_jax.envs.sawyer import experts
from earl_jax.envs.sawyer.base import HAND_HIGH, HAND_LOW, Pose, Sawyer
from earl_jax.envs.sawyer.experts import HANDLE, HANDLE_ANGLE, HINGE
from earl_jax.envs.shaping import tolerance
from earl_jax.envs.state import State, random_row, tree_where
from earl_jax.physics import EngineCost

HEIGHT = np.float32(0.100036)
OPEN = -np.pi / 3
NOISE = np.pi / 20
STOP = -1.39
"""Angle of the widest opening among random starts; the hinge stops at -1.4."""
DOOR = np.array([0.1, 0.95, 0.1], np.float32)
"""The door's own position, which the released dense reward uses as the handle's start."""
CLOSED = np.array([0.29072163, 0.74286009, 0.10003595], np.float32)
START = np.array([0.00591636, 0.39968333, 0.19493164, 1.0, 0.01007495, 0.47104556, 0.10003595], np.float32)
GOAL_RADIUS = 0.05
"""Distance in metres within which the dense reward is at its maximum."""
MAP_MARGIN = np.float32(0.05)
"""Metres by which the map of the hand's positions extends beyond the target's box."""
HOME = Pose(
    target=(0.0, 0.4, 0.2),
    qpos=(
        2.16367893, -0.562765176, -1.22557365, 2.17345908, 1.23729246, 1.00300108, 1.91836351, -1.71855991e-4, 1.71795511e-4,
    ),
    qvel=(
        0.120754458, 0.732927676, -0.264408941, 0.159606751, 0.822370345, 0.475741124, 1.32382885, 2.02805424e-7, 1.930226e-7,
    ),
    warmstart=(
        2.10393017, 0.186386449, -1.34533176, -2.96876418, -5.87818578, 4.2699827, -169.824273, 5.34566832e-5, 5.26419843e-5,
    ),
    hand=(0.00591636, 0.39968333, 0.19493164),
    grip=1.0,
)  # fmt: skip
AT_HANDLE = Pose(
    target=(0.29, 0.74, 0.1),
    qpos=(
        1.14434836, -0.566004762, -0.394321404, 1.22087361, 0.410190009, 0.993834699, 2.38732566, -0.000171862243, -0.0302093972,
    ),
    qvel=(
        0.581056775, 0.425852316, -1.07670188, 0.183160453, 1.24142984, -0.252086692, 3.66312984, 2.35850457e-08, 0.0102117387,
    ),
    warmstart=(
        -4.05638818, 1.28959488, 4.49717997, -4.83336554, -1.80590368, 14.6715431, -356.605034, 8.3488476e-05, -0.110286313,
    ),
    hand=(0.29223742, 0.68626189, 0.11374819),
    grip=0.69962465,
)  # fmt: skip
"""Result of the released reset at the closed door on our own model; in contact, so it differs from the original's."""


@dataclasses.dataclass(frozen=True)
class SawyerDoor(Sawyer):
    """A robot arm closes an open door by its handle.

    The door starts at -60 degrees plus noise of up to 9. Success: the handle is within 2 cm (paper: 8 cm) of its goal.
    `door_noise=False` starts every episode at -60 degrees.
    """

    eval_horizon: int = 300
    door_noise: bool = True

    name: ClassVar[str] = "sawyer_door"
    engine_cost: ClassVar[EngineCost | None] = EngineCost(host=0.10, device=12.6, warp=5.0)
    continuing: ClassVar[ContinuingDefaults] = ContinuingDefaults(600, train_horizon=50_000)
    demo_count: ClassVar[int] = 5
    radius: ClassVar[dict[str, float]] = {"released": 0.02, "paper": 0.08}
    released_goals: ClassVar[np.ndarray] = np.concatenate([CLOSED, [np.float32(1.0)], CLOSED])[None]
    released_starts: ClassVar[np.ndarray] = START[None]
    object_low: ClassVar[np.ndarray] = np.array([-0.2, 0.4, 0.05], np.float32)
    object_high: ClassVar[np.ndarray] = np.array([0.35, 0.85, 0.15], np.float32)

    @property
    def pose(self) -> Pose:
        return AT_HANDLE if self.reset_at_goal else HOME

    def reset(self, key: jax.Array) -> State:
        goal = jnp.asarray(self.goal_states)[0]
        noise = jax.random.uniform(key, maxval=NOISE if self.door_noise else 0.0)
        angle = -noise if self.reset_at_goal else OPEN + noise
        return self.start_at(angle[None], handle_at(angle), goal)

    @property
    def starts(self) -> Starts:
        """The wide starts: half of them are ordinary, and in the other half door and arm can be anywhere.

        The door's angle is uniform from its stop to 9 degrees from closed, and the arm rests in one of 16 poses across
        its range that do not touch the door at any angle. The release has no such starts.
        """
        return Starts(wide=self._wide_start if self.sparse and not self.reset_at_goal else None)

    def _wide_start(self, key: jax.Array) -> State:
        start_key, far_key, angle_key, arm_key = jax.random.split(key, 4)
        angle = jax.random.uniform(angle_key, minval=STOP, maxval=-NOISE)
        rest = random_row(arm_key, assets.starts(assets.asset_name(self)))
        still = jnp.zeros_like(rest["qpos"])
        arm = Pose(rest["target"], rest["qpos"], still, still, rest["hand"], grip=1.0)
        far = self.start_at(angle[None], handle_at(angle), jnp.asarray(self.goal_states)[0], arm)
        return tree_where(jax.random.bernoulli(far_key), far, self.reset(start_key))

    def joints_at(self, position: jax.Array) -> jax.Array:
        """Return the door's angle [1] with its handle at `position [3]`."""
        x, y = position[:2] - HINGE
        return (jnp.arctan2(y, x) - HANDLE_ANGLE)[None]

    @property
    def map(self) -> Map:
        """The hand's positions."""
        bounds = np.stack([HAND_LOW[:2] - MAP_MARGIN, HAND_HIGH[:2] + MAP_MARGIN])
        return Map(position=lambda obs: obs[..., :2], bounds=bounds)

    def reward(self, obs: jax.Array) -> jax.Array:
        if self.sparse:
            return self.success(obs).astype(jnp.float32)
        hand, handle = obs[..., :3], self.object_in(obs)
        hand_start = jnp.asarray(self.pose.target, jnp.float32)
        reach = jnp.linalg.norm(hand_start - handle, axis=-1) + 0.1
        margin = jnp.linalg.norm(DOOR - obs[..., -3:], axis=-1)
        near = tolerance(jnp.linalg.norm(hand - handle, axis=-1), 0.0, GOAL_RADIUS / 4, reach)
        placed = tolerance(self.to_goal(obs), 0.0, GOAL_RADIUS, margin)
        return jnp.where(self.to_goal(obs) < GOAL_RADIUS, 10.0, 3.0 * near + 6.0 * placed)

    def _expert(self, obs: jax.Array) -> jax.Array:
        return experts.door(obs[:3], self.object_in(obs), obs[-3:])


def handle_at(angle: jax.Array) -> jax.Array:
    """Return the position [3] of the handle with the door at `angle` (radians, 0 closed, negative open)."""
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    x = HINGE[0] + cos * HANDLE[0] - sin * HANDLE[1]
    y = HINGE[1] + sin * HANDLE[0] + cos * HANDLE[1]
    return jnp.stack([x, y, jnp.full_like(x, HEIGHT)])
