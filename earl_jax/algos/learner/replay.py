"""One time-ordered replay buffer for all lanes, written in place and never evicted.

Rows are time: row t of `state` is s_t, of `action` a_t, and s_{t+1} is row t + 1. Goals are an index into a static table,
so a relabelled copy costs nothing. Which rows may be sampled, and by which controller, is kept in one list a lane that
fills from both ends: the task controller's rows from the left, the other's from the right.

Every function works on the whole batch of lanes: `jax.vmap` of a write would turn it into a scatter over the buffer, and
of a read into a transpose of it.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import struct

GOAL_BITS = 16
REACHED, TIMEOUT, NO_SUCCESSOR, ABSORBED = (1 << (GOAL_BITS + bit) for bit in range(4))


class TransitionFlags(NamedTuple):
    """The `goal` index of a transition, and whether it `reached` the goal, hit a `timeout`, has `no_successor` or was `absorbed`.

    It has no successor where a reset overwrote the next state, and it is absorbed where the lifetime ended.
    """

    goal: jax.Array
    reached: jax.Array
    timeout: jax.Array
    no_successor: jax.Array
    absorbed: jax.Array


class Transition(NamedTuple):
    """What one step adds, one row a lane: `action [N, a]`, `next_state [N, s]` to go on from, `reward [N]`, `flags`."""

    action: jax.Array
    next_state: jax.Array
    reward: jax.Array
    flags: TransitionFlags


class TransitionBatch(NamedTuple):
    """Sampled transitions of every lane: `row [N, B]` they stand in, `state, next_state [N, B, s]`, `action`, `reward`,
    `flags`."""

    row: jax.Array
    state: jax.Array
    action: jax.Array
    next_state: jax.Array
    reward: jax.Array
    flags: TransitionFlags


class Replay(struct.PyTreeNode):
    """The buffer of N lanes and capacity C; `reward` has no rows where the reward is a success bit.

    `state [C + 1, N, s]`, `action [C, N, a]`, packed `flags [C, N]`, `reward [C or 0, N]`, `index [C, N]` of row numbers,
    `counts [N, 2]` rows listed for each controller, the first `demos [2]` of them demonstrations, `row []` the next free
    row.
    """

    state: jax.Array
    action: jax.Array
    flags: jax.Array
    reward: jax.Array
    index: jax.Array
    counts: jax.Array
    demos: jax.Array
    row: jax.Array

    @property
    def capacity(self) -> int:
        """Transitions that fit."""
        return self.action.shape[0]


def bytes_per_transition(state_size: int, action_size: int, sparse: bool) -> int:
    """Return what one transition of one lane occupies, in bytes."""
    return 4 * (state_size + action_size + 2 + (not sparse))


def create(capacity: int, lanes: int, state_size: int, action_size: int, sparse: bool) -> Replay:
    """Return an empty buffer; goals are packed into 16 bits, so a goal table may hold 65,536 entries."""
    return Replay(
        state=jnp.zeros((capacity + 1, lanes, state_size)),
        action=jnp.zeros((capacity, lanes, action_size)),
        flags=jnp.zeros((capacity, lanes), jnp.int32),
        reward=jnp.zeros((0 if sparse else capacity, lanes)),
        index=jnp.zeros((capacity, lanes), jnp.int32),
        counts=jnp.zeros((lanes, 2), jnp.int32),
        demos=jnp.zeros((2,), jnp.int32),
        row=jnp.zeros((), jnp.int32),
    )


def pack(flags: TransitionFlags) -> jax.Array:
    """Return `flags` as int32 words."""
    bits = (
        REACHED * flags.reached
        + TIMEOUT * flags.timeout
        + NO_SUCCESSOR * flags.no_successor
        + ABSORBED * flags.absorbed
    )
    return flags.goal.astype(jnp.int32) | bits.astype(jnp.int32)


def unpack(words: jax.Array) -> TransitionFlags:
    """Return the flags of int32 `words`."""
    bits = [(words & bit) != 0 for bit in (REACHED, TIMEOUT, NO_SUCCESSOR, ABSORBED)]
    return TransitionFlags(words & (REACHED - 1), *bits)


@jax.named_scope("store")
def write(replay: Replay, transition: Transition, valid: jax.Array, controller: jax.Array) -> Replay:
    """Append one transition a lane, listed for `controller [N]` where `valid [N]`.

    After a reset the state to go on from is the new start, and the successor is lost.
    """
    row, lanes = replay.row, jnp.arange(valid.shape[0])

    def put(buffer, values, at):
        return jax.lax.dynamic_update_slice(buffer, values[None], (at,) + (0,) * values.ndim)

    filled = replay.counts[lanes, controller]
    slot = jnp.where(controller == 0, filled, replay.capacity - 1 - filled)
    slot = jnp.where(valid, slot, replay.capacity)
    return replay.replace(
        state=put(replay.state, transition.next_state, row + 1),
        action=put(replay.action, transition.action, row),
        flags=put(replay.flags, pack(transition.flags), row),
        reward=put(replay.reward, transition.reward, row) if replay.reward.shape[0] else replay.reward,
        index=replay.index.at[slot, lanes].set(row, mode="drop"),
        counts=replay.counts.at[lanes, controller].add(valid.astype(jnp.int32)),
        row=row + 1,
    )


@jax.named_scope("sample")
def sample(replay: Replay, keys: jax.Array, controller: jax.Array, size: int, demo_share: jax.Array) -> TransitionBatch:
    """Return `size` transitions a lane, uniform with replacement over what is listed for `controller [N]`.

    A share `demo_share [N]` of them is drawn from the demonstrations alone. Where nothing is listed for a controller yet, at its
    very first step, it is given what the other one did. A lane's draw depends on its own key and counts only, never on how many
    lanes run beside it.
    """
    lanes = jnp.arange(controller.shape[0])[:, None]
    controller = jnp.where(replay.counts[lanes[:, 0], controller] > 0, controller, 1 - controller)
    draw = jax.vmap(_draw, (0, 0, 0, 0, None))
    listed = draw(keys, replay.counts[lanes[:, 0], controller], replay.demos[controller], demo_share, size)
    slot = jnp.where(controller[:, None] == 0, listed, replay.capacity - 1 - listed)
    rows = replay.index[slot, lanes]
    flags = unpack(replay.flags[rows, lanes])
    reward = replay.reward[rows, lanes] if replay.reward.shape[0] else flags.reached.astype(jnp.float32)
    state, action, following = replay.state[rows, lanes], replay.action[rows, lanes], replay.state[rows + 1, lanes]
    return TransitionBatch(rows, state, action, following, reward, flags)


def _draw(key: jax.Array, count: jax.Array, demos: jax.Array, demo_share: jax.Array, size: int) -> jax.Array:
    """Return positions [size] in one lane's list of `count` rows; integers, because float32 tells no two of 2**24 apart."""
    share_key, place_key = jax.random.split(key)
    from_demos = (jax.random.uniform(share_key, (size,)) < demo_share) & (demos > 0)
    return jax.random.randint(place_key, (size,), 0, jnp.maximum(jnp.where(from_demos, demos, count), 1))
