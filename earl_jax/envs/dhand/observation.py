"""The DHand's observation in both variants, and the orientation of the wrist.

The paper's text lists 16 hand joints, 7 arm joints, 3 numbers, a 3-dimensional Euler angle, 6 inter-object distances,
and the goal state. The list sums to 35, although the text says 30, which is the number of MuJoCo's joint values
including the object's pose. The observation was never released. The variants differ in their state:

- `reconstruction` (32): fingers 16, arm 7, bulb 3, hand 3, hand minus bulb 3.
- `paper` (35): fingers 16, arm 7, bulb 3, Euler angle of the bulb 3, hand minus bulb 3, bulb minus the task's target 3.

Both are followed by the goal 3.
"""

from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np

FINGERS, ARM = 16, 7
Variant = Literal["reconstruction", "paper"]
STATE = {"reconstruction": FINGERS + ARM + 9, "paper": FINGERS + ARM + 12}
"""Length of a state in each variant."""
POSE = FINGERS + ARM + 3
"""Index of the first number in which the variants differ, where the hand's position or the bulb's Euler angle begins.
Hand minus bulb follows in both."""
REACH = 0.01
"""Metres that the mocap target moves for an action of 1."""
TABLE = 0.72
"""Height of the table, metres."""
TARGET = np.array([0.72, 0.15, 0.92], np.float32)
"""The task's goal: the desired position of the bulb's middle, metres."""


def parts(obs: jax.Array, variant: Variant) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """Return the fingers' joints [..., 16], bulb [..., 3], hand [..., 3] and goal [..., 3] in `obs [..., o]`."""
    bulb, size = obs[..., POSE - 3 : POSE], STATE[variant]
    hand = bulb + obs[..., POSE + 3 : POSE + 6] if variant == "paper" else obs[..., POSE : POSE + 3]
    return obs[..., :FINGERS], bulb, hand, obs[..., size : size + 3]


def observed(qpos: jax.Array, hand: jax.Array, variant: Variant) -> jax.Array:
    """Return the state [s] for joints `qpos [30]` and the point between the fingers at `hand [3]`.

    The order is MTRF's: fingers before the arm. As in MTRF, joints and bulb are current, `hand` lags by one substep.
    """
    arm, fingers, bulb = qpos[:ARM], qpos[ARM : ARM + FINGERS], qpos[ARM + FINGERS : ARM + FINGERS + 3]
    if variant == "paper":
        return jnp.concatenate(
            [fingers, arm, bulb, euler_angle(qpos[ARM + FINGERS + 3 :]), hand - bulb, bulb - jnp.asarray(TARGET)]
        )
    return jnp.concatenate([fingers, arm, bulb, hand, hand - bulb])


def euler_angle(quat: jax.Array) -> jax.Array:
    """Return roll, pitch and yaw [3] of an orientation `quat [4]`, radians, about its own x, y and z axis."""
    w, x, y, z = quat
    roll = jnp.arctan2(2 * (w * x - y * z), 1 - 2 * (x * x + y * y))
    pitch = jnp.arcsin(jnp.clip(2 * (x * z + w * y), -1.0, 1.0))
    yaw = jnp.arctan2(2 * (w * z - x * y), 1 - 2 * (y * y + z * z))
    return jnp.stack([roll, pitch, yaw])


def palm_down(yaw: jax.Array) -> jax.Array:
    """Return the mocap target's orientation [4]: roll by -pi, then `yaw`; MTRF's yaw is clockwise from above."""
    zero = jnp.zeros_like(yaw)
    return jnp.stack([zero, jnp.cos(yaw / 2), -jnp.sin(yaw / 2), zero])


def yaw_of(quat: jax.Array) -> jax.Array:
    """Return the yaw [] of a palm-down orientation `quat [4]`."""
    return -2.0 * jnp.arctan2(quat[2], quat[1])
