"""The scripted grasp of the DHand: it lifts the bulb and carries it to its goal, which may be on the table."""

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.envs.dhand.observation import REACH, TABLE

OPENED = np.array(
    [0.189, 0.197, -0.139, 0.352, 0.0, 0.197, -0.139, 0.352, -0.189, 0.197, -0.139, 0.352, 0.732, -0.143, 0.286, 0.531],
    np.float32,
)
CLOSED = np.array(
    [0.189, 0.874, 1.018, 0.816, 0.0, 0.874, 1.018, 0.816, -0.189, 0.874, 1.018, 0.816, 1.457, -0.143, 1.536, 1.559],
    np.float32,
)
"""Finger joints of the scripted grasp: before the grasp, and the target of the squeeze. Determined by search."""
BENDS = OPENED != CLOSED
PALM_OVER = np.array([-0.027, -0.022, -0.009], np.float32)
"""Offset of the hand from the bulb in the scripted grasp."""
GRIPS, MARGINS = np.array([0.1, 0.4], np.float32), np.array([0.012, 0.06], np.float32)
"""The grasp continues while the hand is within `MARGINS` of that offset; the margin is interpolated over the closure of
the hand, `GRIPS`."""
HELD = 0.65
CLOSING, OPENING = 1.3, 3.0
TRAVEL, CARRY = 0.865, 0.86
"""Heights [m] at which the hand travels to the bulb, and at which it carries the bulb to its goal."""
PACE = 0.7
OFF_TABLE = TABLE + 0.1
"""Height [m] above which the bulb is carried sideways."""


def action(fingers: jax.Array, bulb: jax.Array, hand: jax.Array, goal: jax.Array) -> jax.Array:
    """Return the action [22] for the joints `fingers [16]` and the positions `bulb`, `hand`, `goal [3]` in metres.

    The controller has no memory: the closure of the fingers decides whether it goes on closing or starts to lift.
    """
    opened, closed = jnp.asarray(OPENED), jnp.asarray(CLOSED)
    grip = ((fingers - opened) * BENDS).sum() / ((closed - opened) * BENDS).sum()
    grasp_position = bulb + PALM_OVER
    around = jnp.abs(hand - grasp_position).max() < jnp.interp(grip, GRIPS, MARGINS)
    move = jnp.where(around, jnp.where(grip > HELD, _carry(bulb, goal), 0.0), _approach(hand, grasp_position, grip))
    squeeze = jnp.where(around, CLOSING * (closed - fingers), OPENING * (opened - fingers))
    return jnp.clip(jnp.concatenate([squeeze, move, jnp.zeros(3)]), -1.0, 1.0)


def _approach(hand: jax.Array, target: jax.Array, grip: jax.Array) -> jax.Array:
    """Return the wrist's move [3] to `target [3]`: up if the hand is low and far, across, then down if it is open."""
    away = jnp.linalg.norm((target - hand)[:2])
    across = jnp.where((hand[2] < TRAVEL - 0.025) & (away > 0.05), hand[:2], target[:2])
    height = jnp.where((away > 0.012) | (grip > 0.4), jnp.maximum(target[2], TRAVEL), target[2])
    return _towards(jnp.append(across, height) - hand)


def _carry(bulb: jax.Array, goal: jax.Array) -> jax.Array:
    """Return the wrist's move [3] that carries a held `bulb [3]` to `goal [3]`: up, across, and down to a low goal."""
    apart = goal - bulb
    far = jnp.linalg.norm(apart[:2]) > 0.03
    height = jnp.where(far, jnp.maximum(goal[2], CARRY), goal[2])
    across = jnp.where(bulb[2] > OFF_TABLE, apart[:2], 0.0)
    return _towards(jnp.append(across, height - bulb[2]))


def _towards(step: jax.Array) -> jax.Array:
    """Return the move [3] for `step [3]` metres, clipped to `PACE`."""
    return jnp.clip(PACE * step / REACH, -PACE, PACE)
