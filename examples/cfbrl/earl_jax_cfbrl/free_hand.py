"""Transitions of a free hand at other places than the demonstrated ones, with actions that lead back to those."""

import jax
import jax.numpy as jnp

from earl_jax.envs.sawyer.base import GRIPPER, HAND_HIGH, HAND_LOW
from earl_jax.envs.sawyer.experts import GAIN, limited
from earl_jax.envs.state import tree_where
from earl_jax_cfbrl.knowledge import Correction

STILL = 0.001
"""Metres per step up to which the object rests."""
CLEARANCE = 0.05
"""Metres between hand and grasp position within which the gripper's reading belongs to the grasp."""
FAR = 0.1
"""Metres from the grasp position from which the hand is placed anywhere, half of the time."""
SPREAD, LEAST = 0.3, 0.005
"""Standard deviation of the other places, as a share of the distance to the grasp position, and its minimum [m]."""
SPEED = 0.008
"""Metres per step at action 1: 1 cm when moving steadily, less while the arm accelerates."""
CLOSED, OPENING_RATE = 0.28, 0.05
"""Smallest reading of the gripper, and the change of an opening one in a step."""


def free_hand(
    key: jax.Array, state: jax.Array, action: jax.Array, next_state: jax.Array, grasp: jax.Array
) -> Correction:
    """Return the transition from `state [7]` with the hand elsewhere, and often the gripper further closed.

    `grasp [3]` is where the hand grasps the object. The action leads to the demonstrated place and adds the demonstrated
    one. The next state is approximate: the hand moves by `SPEED` for each unit of action, the object rests. The nearer
    the grasp position, the nearer the other place. A transition that moves the object is returned as it is.
    """
    near_key, far_key, choice_key, grip_key, close_key = jax.random.split(key, 5)
    hand, distance = state[:3], jnp.linalg.norm(state[:3] - grasp)
    approach = jnp.linalg.norm(next_state[-3:] - state[-3:]) < STILL
    near = hand + jax.random.normal(near_key, (3,)) * jnp.maximum(SPREAD * distance, LEAST)
    anywhere = jax.random.uniform(far_key, (3,), minval=HAND_LOW, maxval=HAND_HIGH)
    other_hand = jnp.where((distance > FAR) & jax.random.bernoulli(choice_key), anywhere, near)
    other_hand = jnp.clip(other_hand, HAND_LOW, HAND_HIGH)
    away = jnp.linalg.norm(other_hand - grasp)
    moved = approach & ((away > CLEARANCE) | (distance < 2 * CLEARANCE))
    move = limited(action[:3] + GAIN * (hand - other_hand))
    closed = (away > CLEARANCE) & (action[GRIPPER] < 0) & jax.random.bernoulli(close_key)
    grip = jnp.where(closed, jax.random.uniform(grip_key, minval=CLOSED), state[GRIPPER])
    next_grip = jnp.where(closed, jnp.minimum(grip + OPENING_RATE, 1.0), next_state[GRIPPER])
    following = other_hand + next_state[:3] - hand + SPEED * (move - action[:3])
    other = Correction(
        jnp.concatenate([other_hand, grip[None], state[4:]]),
        jnp.concatenate([move, action[3:]]),
        jnp.concatenate([following, next_grip[None], next_state[4:]]),
        approach,
    )
    return tree_where(moved, other, Correction(state, action, next_state, approach))
