"""The DHand's observation in both variants, and the orientation of the wrist.

The paper's text lists 16 hand joints, 7 arm joints, 3 numbers, a 3-dimensional Euler angle, and 6 numbers: 35, although
it says 30. It was never released. Both variants have 35 numbers; they differ in three of them:

- `reconstruction`: fingers 16, arm 7, bulb 3, hand 3, hand minus bulb 3, goal 3.
- `paper`: fingers 16, arm 7, bulb 3, Euler angle of the wrist 3, hand minus bulb 3, goal 3.

We take the Euler angle as the wrist's, because MTRF (Gupta et al. 2021) observes the Euler angle of the wrist's target
and leaves out the object's.
"""

import jax
import jax.numpy as jnp
import numpy as np

FINGERS, ARM = 16, 7
VARIANTS = ("reconstruction", "paper")
STATE = FINGERS + ARM + 9
"""Length of a state in both variants."""
POSE = FINGERS + ARM + 3
"""Index of the first of the three numbers in which the variants differ: the hand's position or the Euler angle."""
REACH = 0.01
"""Metres that the mocap target moves at action 1."""
TABLE = 0.72
"""Height of the table, metres."""
ROLL = -np.pi
"""Radians by which the wrist is rolled, palm down: the first Euler angle. The second, pitch, is 0."""


def parts(obs: jax.Array, variant: str = VARIANTS[0]) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """Return from `obs [..., 35]` the fingers' joints [..., 16], bulb [..., 3], hand [..., 3] and goal [..., 3]."""
    bulb = obs[..., POSE - 3 : POSE]
    hand = bulb + obs[..., POSE + 3 : STATE] if variant == "paper" else obs[..., POSE : POSE + 3]
    return obs[..., :FINGERS], bulb, hand, obs[..., STATE : STATE + 3]


def observed(qpos: jax.Array, hand: jax.Array, wrist: jax.Array, variant: str) -> jax.Array:
    """Return the state [32] for joints `qpos [30]`, the point between the fingers at `hand [3]`, the target `wrist [4]`.

    The order is MTRF's, fingers before the arm. As in MTRF, joints and bulb are current and the hand lags by one
    substep. `wrist` is the orientation of the mocap target; the reconstruction leaves it out.
    """
    arm, fingers, bulb = qpos[:ARM], qpos[ARM : ARM + FINGERS], qpos[ARM + FINGERS : ARM + FINGERS + 3]
    return jnp.concatenate([fingers, arm, bulb, wrist_euler(wrist) if variant == "paper" else hand, hand - bulb])


def wrist_euler(quat: jax.Array) -> jax.Array:
    """Return roll, pitch and yaw [3] of a palm-down orientation `quat [4]`, radians, about its own x, y and z axis.

    This is MTRF's `mocap_euler`. Roll and pitch are constant, because their actions have no effect, as in MTRF.
    """
    return jnp.stack([jnp.asarray(ROLL), jnp.asarray(0.0), yaw_of(quat)])


def palm_down(yaw: jax.Array) -> jax.Array:
    """Return the mocap target's orientation [4]: roll by -pi, then `yaw`; MTRF's yaw is clockwise from above."""
    zero = jnp.zeros_like(yaw)
    return jnp.stack([zero, jnp.cos(yaw / 2), -jnp.sin(yaw / 2), zero])


def yaw_of(quat: jax.Array) -> jax.Array:
    """Return the yaw [] of a palm-down orientation `quat [4]`."""
    return -2.0 * jnp.arctan2(quat[2], quat[1])
