"""Scripted controllers of the Sawyer tasks: pure functions of state and goal, for forward and backward goals."""

import jax
import jax.numpy as jnp
import numpy as np

GAIN = 25.0
"""Action per metre of distance: full speed from 4 cm on."""
HOVER = 0.21
"""Height [m] at which the hand travels above all objects."""
STEEP = 1.0
"""Slope of the cone along which the hand descends to a target."""
CLOSE, OPEN = 1.0, -1.0

HINGE = np.array([-0.085, 0.85], np.float32)
HANDLE = np.array([0.375722, -0.10714])
"""The handle's position relative to the hinge, in the door's frame."""
HANDLE_ANGLE = np.arctan2(HANDLE[1], HANDLE[0])
PUSH, PULL = np.array([0.375, -0.175], np.float32), np.array([0.415, -0.055], np.float32)
"""Positions from which the hand moves the door, in the door's frame: in front of the handle to close it, and behind the
free end of the handle to open it."""
BAR = -0.12
"""Depth of the handle's bar in the door's frame."""
HANDLE_HEIGHT = 0.1

GRASP = np.array([0.14, 0.0, 0.0], np.float32)
"""Grasp position of the script, relative to the peg's head."""
PEG_GRIP = 0.05
HELD = 0.5
"""Observed opening below which the gripper has closed on the peg."""
LIFTED = 0.13
OUT = -0.05


def steer(hand: jax.Array, target: jax.Array, grip: jax.Array | float) -> jax.Array:
    """Return the action [4] that moves `hand [3]` straight to `target [3]` with the gripper at `grip`."""
    return jnp.append(limited(GAIN * (target - hand)), grip)


def limited(move: jax.Array) -> jax.Array:
    """Return `move [3]`, scaled down without changing its direction if a component is outside [-1, 1]."""
    scaled = move / jnp.maximum(1.0, jnp.abs(move).max())
    return jnp.clip(scaled, -1.0, 1.0)  # XLA may round the quotient of equal numbers to more than 1


def travel(hand: jax.Array, target: jax.Array, near: float) -> jax.Array:
    """Return the next waypoint [3] to `target [3]`: up, across, and down a cone with a tip of radius `near`."""
    away = jnp.linalg.norm((target - hand)[:2])
    height = jnp.clip(target[2] + STEEP * (away - near), target[2], HOVER)
    clear = hand[2] > height - 0.03
    across = jnp.where(clear, target[:2], hand[:2])
    return jnp.append(across, height)


def door(hand: jax.Array, handle: jax.Array, goal: jax.Array) -> jax.Array:
    """Return the action [4] that moves the door's `handle [3]` to `goal [3]`, for any position of the hand."""
    angle, aim = (jnp.arctan2(*(point[:2] - HINGE)[::-1]) - HANDLE_ANGLE for point in (handle, goal))
    turn = jnp.array([[jnp.cos(angle), -jnp.sin(angle)], [jnp.sin(angle), jnp.cos(angle)]])
    closing = aim > angle
    start, onward = jnp.where(closing, PUSH, PULL), jnp.where(closing, 0.12, -0.12)
    local_hand = turn.T @ (hand[:2] - HINGE)
    side = jnp.where(closing, BAR - local_hand[1], local_hand[1] - BAR)
    width = jnp.where(closing, 0.08, 0.045)
    ready = (
        (side > 0.015) & (side < 0.12) & (jnp.abs(local_hand[0] - start[0]) < width) & (hand[2] < HANDLE_HEIGHT + 0.035)
    )
    working = jnp.array([start[0], local_hand[1] + onward])
    across = HINGE + turn @ jnp.where(ready, working, start)
    target = jnp.append(across, HANDLE_HEIGHT + 0.01)
    return steer(hand, jnp.where(ready, target, travel(hand, target, 0.03)), CLOSE)


def peg_grasp(head: jax.Array) -> jax.Array:
    """Return the position [3] at which the hand grasps a peg with its `head [3]`."""
    return jnp.maximum(head + GRASP + jnp.array([0.0, 0.0, 0.025]), jnp.array([-1.0, 0.0, PEG_GRIP]))


def peg(hand: jax.Array, grip: jax.Array, head: jax.Array, goal: jax.Array) -> jax.Array:
    """Return the action [4] that moves the peg's `head [3]` to `goal [3]`: into the hole, or out of it and down."""
    grasp_position = peg_grasp(head)
    offset = hand - grasp_position
    enclosed = (jnp.abs(offset[0]) < 0.03) & (jnp.abs(offset[1]) < 0.025) & (jnp.abs(offset[2]) < 0.02)
    held = enclosed & (grip < HELD)
    fetch = steer(hand, travel(hand, grasp_position, 0.02), jnp.where(enclosed, CLOSE, OPEN))
    inserting = goal[2] > 0.08
    inside = head[0] < -0.15
    aligned = (jnp.abs(head[1] - goal[1]) < 0.012) & (jnp.abs(head[2] - LIFTED) < 0.012)
    approach = jnp.stack([jnp.maximum(head[0], -0.12), goal[1], jnp.asarray(LIFTED)])
    insert = jnp.where(aligned | inside, jnp.stack([goal[0] - 0.02, goal[1], jnp.asarray(LIFTED)]), approach)
    out = jnp.where(head[0] < OUT - 0.1, jnp.stack([jnp.asarray(OUT), head[1], head[2]]), goal)
    carry = hand + jnp.where(inserting, insert, out) - head
    return jnp.where(held, steer(hand, carry, CLOSE), fetch)
