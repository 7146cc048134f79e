"""Where transitions of the peg can be moved to: translations across the table, and corrections of hand and peg."""

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.envs.sawyer import experts
from earl_jax.envs.sawyer.base import GRIPPER
from earl_jax.envs.sawyer.peg import BLOCK
from earl_jax.envs.state import tree_where
from earl_jax_cfbrl.free_hand import CLOSED, SPEED, free_hand
from earl_jax_cfbrl.knowledge import Correction

HALF_WIDTH = 0.1
"""Half of the block's width [m]."""
BEHIND, PEG_BESIDE, HAND_BESIDE = -0.17, 0.125, 0.16
"""Metres: neither a peg's head nor a hand touches the block from a larger x or a larger |y - 0.6| on."""
FREE_LOW, FREE_HIGH = np.array([-0.45, 0.36], np.float32), np.array([0.35, 0.87], np.float32)
"""x, y [m] of the heads to which the peg is moved: the hand can lift most (benchmarks/results/cloning/peg_reach.csv)."""
HAND_FREE_LOW, HAND_FREE_HIGH = np.array([-0.45, 0.4], np.float32), np.array([0.48, 0.88], np.float32)
"""x, y [m] of the hand at which neither the end of its range nor that of the arm's reach slows it."""
INSIDE, DEEPER, HOLE_RADIUS, HOLE_LOW = -0.2, 0.06, 0.05, 0.07
"""Metres: x of a head in the hole, how much deeper than demonstrated the peg can be pushed, |y - 0.6| and z of the hole."""
OUTSIDE = -0.15
"""x [m] of the heads of a peg that is not being inserted."""
LYING, CARRIED = 0.008, 0.15
"""Heights [m] of the head between which a carried peg is placed."""
NEAR = np.array([0.03, 0.03, 0.015], np.float32)
"""Standard deviation [m] of the places near the demonstrated one, which half of the carried pegs take."""
IN_HAND = np.array([0.04, 0.03, 0.03], np.float32)
"""Largest offset [m] of the hand from the grasp position of a carried peg."""
DETOUR = 0.03
"""Metres against the demonstrated move by which a carried peg is led back at most."""
CORNER, PAST = -0.13, -0.09
"""x [m] of the heads beside the block up to which a peg is carried along x first, and where that leads."""
SHARE_AROUND = 0.25
"""Share of the corrected approaches that lead around the block."""
BLOCKED = -0.31
"""x [m] of the heads beside the block up to which it is in the way of a hand in front of it."""
NEARBY = np.array([[-0.3, 0.38, 0.07], [0.3, 0.82, 0.25]], np.float32)
"""Smallest and largest position [m] of a hand that is led around the block."""
TURN, ASIDE = -0.13, 0.25
"""x and |y - 0.6| [m] to which a hand moves while the block is in its way; it turns around the corner before."""


def translation(key: jax.Array, state: jax.Array, next_state: jax.Array) -> jax.Array:
    """Return a vector [7] that moves hand and peg of a transition alike across the table, or 0.

    It is 0 where the block touches the peg or the hand, or decides about the action: from beside it, and to where it is in
    the way.
    """
    offset = jax.random.uniform(key, (2,), minval=FREE_LOW, maxval=FREE_HIGH) - state[4:6]
    both = jnp.stack([state, next_state])
    hands, heads = both[:, :2], both[:, 4:6]
    free = _free(hands, heads) & _free(hands + offset, heads + offset)
    free &= ~_beside(heads).any() & ~_blocked(hands + offset, heads + offset).any()
    return jnp.where(free, _moved_by(jnp.append(offset, 0.0)), 0.0)


def correction(key: jax.Array, state: jax.Array, action: jax.Array, next_state: jax.Array) -> Correction:
    """Return the transition from `state [7]` with a free hand, a carried peg or both elsewhere, or an inserted peg deeper."""
    heads = jnp.stack([state[4:7], next_state[4:7]])
    inside = ((heads[:, 0] < INSIDE) & (jnp.abs(heads[:, 1] - BLOCK[1]) < HOLE_RADIUS) & (heads[:, 2] > HOLE_LOW)).all()
    depth = jnp.where(inside, jax.random.uniform(jax.random.fold_in(key, 1), maxval=DEEPER), 0.0)
    deeper = jnp.zeros_like(state).at[4].set(-depth)
    grasp = state[4:7] + experts.GRASP
    approach = free_hand(key, state + deeper, action, next_state + deeper, grasp)
    carried, valid = _carried(jax.random.fold_in(key, 2), state, action, next_state)
    lying = approach.approach & (state[6] < HOLE_LOW)
    around = lying & jax.random.bernoulli(jax.random.fold_in(key, 3), SHARE_AROUND)
    approach = tree_where(around, _around(jax.random.fold_in(key, 4), state), approach)
    return tree_where(valid, carried, approach)


def _around(key: jax.Array, state: jax.Array) -> Correction:
    """Return an approach to a peg beside the block, from in front of the block or beside it.

    The hand moves to the side until the block is no longer in its way, and then as the script does (`experts.travel`).
    """
    side_key, head_key, hand_key, grip_key = jax.random.split(key, 4)
    side = jnp.where(jax.random.bernoulli(side_key), 1.0, -1.0)
    low, high = np.array([FREE_LOW[0], PEG_BESIDE]), np.array([BLOCKED, BLOCK[1] - FREE_LOW[1]])
    x, away = jax.random.uniform(head_key, (2,), minval=low, maxval=high)
    head = jnp.stack([x, BLOCK[1] + side * away, state[6]])
    hand = jax.random.uniform(hand_key, (3,), minval=NEARBY[0], maxval=NEARBY[1])
    blocked = side * (hand[1] - BLOCK[1]) < HAND_BESIDE
    hand = hand.at[0].max(jnp.where(blocked, BEHIND, NEARBY[0, 0]))
    turn = jnp.stack([jnp.asarray(TURN), BLOCK[1] + side * ASIDE, jnp.asarray(experts.HOVER)])
    onward = experts.travel(hand, experts.peg_grasp(head), 0.02)
    action = experts.steer(hand, jnp.where(blocked, turn, onward), experts.OPEN)
    grip = jax.random.uniform(grip_key, (1,), minval=CLOSED)
    moved = jnp.concatenate([hand, grip, head])
    following = moved.at[:3].add(SPEED * action[:3])
    return Correction(moved, action, following, jnp.ones((), bool))


def _carried(
    key: jax.Array, state: jax.Array, action: jax.Array, next_state: jax.Array
) -> tuple[Correction, jax.Array]:
    """Return the transition with hand and carried peg at another place, and whether that is possible, bool [].

    The action leads to the demonstrated place and adds the demonstrated one. From beside the block it leads up and past
    the block's corner first. The next state is approximate: the hand moves by `SPEED` for each unit of action.
    """
    near_key, far_key, choice_key = jax.random.split(key, 3)
    head = state[4:7]
    low, high = jnp.append(FREE_LOW, LYING), jnp.append(FREE_HIGH, CARRIED)
    near = head + NEAR * jax.random.normal(near_key, (3,))
    anywhere = jax.random.uniform(far_key, (3,), minval=low, maxval=high)
    other = jnp.clip(jnp.where(jax.random.bernoulli(choice_key), near, anywhere), low, high)
    offset = other - head
    outside = (state[4] > OUTSIDE) & (next_state[4] > OUTSIDE)
    beside = _beside(other)
    past = jnp.stack([PAST - other[0], jnp.zeros(()), experts.LIFTED - other[2]])
    ahead = beside | ((offset * action[:3]).sum() < DETOUR)
    free = _free((state[:2] + offset[:2])[None], other[None, :2])
    back = action[:3] - experts.GAIN * offset
    move = experts.limited(jnp.where(beside, experts.GAIN * past, back))
    following = next_state + _moved_by(offset + SPEED * (move - action[:3]))
    moved = Correction(state + _moved_by(offset), jnp.append(move, action[GRIPPER]), following, jnp.zeros((), bool))
    return moved, _in_hand(state, action) & outside & free & ahead


def _in_hand(state: jax.Array, action: jax.Array) -> jax.Array:
    """Return whether the hand holds the peg and goes on to, bool []."""
    offset = state[:3] - experts.peg_grasp(state[4:7])
    return (jnp.abs(offset) < IN_HAND).all() & (state[GRIPPER] < experts.HELD) & (action[GRIPPER] > 0)


def _free(hands: jax.Array, heads: jax.Array) -> jax.Array:
    """Return whether all `hands [n, 2]` and `heads [n, 2]` are clear of the block and the hands move freely, bool []."""
    within = ((hands > HAND_FREE_LOW) & (hands < HAND_FREE_HIGH)).all()
    return within & _clear(hands, HAND_BESIDE).all() & _clear(heads, PEG_BESIDE).all()


def _clear(points: jax.Array, beside: float) -> jax.Array:
    return (points[..., 0] > BEHIND) | (jnp.abs(points[..., 1] - BLOCK[1]) > beside)


def _beside(heads: jax.Array) -> jax.Array:
    """Return which of `heads [..., 2]` are beside the block, bool."""
    return (heads[..., 0] < CORNER) & (jnp.abs(heads[..., 1] - BLOCK[1]) > HALF_WIDTH)


def _blocked(hands: jax.Array, heads: jax.Array) -> jax.Array:
    """Return where the block is in the way from `hands [..., 2]` to pegs with `heads [..., 2]`, bool."""
    return (heads[..., 0] < BLOCKED) & (jnp.abs(hands[..., 1] - BLOCK[1]) < HAND_BESIDE)


def _moved_by(offset: jax.Array) -> jax.Array:
    """Return the change [7] of a state whose hand and peg move by `offset [3]`."""
    return jnp.concatenate([offset, jnp.zeros(1), offset])
