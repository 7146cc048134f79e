"""One time-ordered replay buffer for all lanes, written in place.

Rows are steps: row t of `state` is s_t, row t of `action` is a_t, and s_{t+1} is row t + 1. Goals are indices into a
static table, so relabelling needs no copies. A list for each lane holds the rows that its controllers can sample: the
task controller's rows fill it from the left, the other controller's rows from the right.

In a run that is longer than `Learner.replay_capacity`, the rows after the demonstrations and both lists are rings, in
which a new transition replaces the oldest one. Demonstrations keep their rows.

Every function works on the whole batch of lanes. `jax.vmap` would turn a write into a scatter over the buffer and a
read into a transpose of it.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import struct

GOAL_BITS = 16
FLAG_BITS = [1 << (GOAL_BITS + bit) for bit in range(5)]
"""The bits of the flags in a packed word, in the order of the flags, above the bits of the goal."""


class TransitionFlags(NamedTuple):
    """The `goal` index of a transition and its flags.

    A transition has `no_successor` if a reset overwrote the next state. It is `absorbed` if the lifetime has ended. It
    has `passed` its goal if the next state meets the goal but the phase goes on.
    """

    goal: jax.Array
    reached: jax.Array
    timeout: jax.Array
    no_successor: jax.Array
    absorbed: jax.Array
    passed: jax.Array | bool = False


class Transition(NamedTuple):
    """The row that one step adds to each lane: `action [N, a]`, `next_state [N, s]`, `reward [N]`, `flags`."""

    action: jax.Array
    next_state: jax.Array
    reward: jax.Array
    flags: TransitionFlags


class TransitionBatch(NamedTuple):
    """Sampled transitions: `row [N, B]`, `state, next_state [N, B, s]`, `action [N, B, a]`, `reward`, `flags`.

    The functions of a method receive those of one lane, without the axis N.
    `demonstrated [N, B]`, bool, marks demonstrations. `later [N, B, s]` are states of the same lane some steps later,
    for methods with `later_steps`. A method that learns from other goals than the table's puts them into `goal [N, B,
    g]`, which replaces the indices `flags.goal`.
    """

    row: jax.Array
    state: jax.Array
    action: jax.Array
    next_state: jax.Array
    reward: jax.Array
    flags: TransitionFlags
    demonstrated: jax.Array
    later: jax.Array | None = None
    goal: jax.Array | None = None


CONTROLLERS = 2
"""The number of controllers that have a list of their own in a replay."""


class Replay(struct.PyTreeNode):
    """The buffer of N lanes with capacity C.

    `state [C + 1, N, s]`, `action [C, N, a]`, packed `flags [C, N]` and `reward [C or 0, N]`, which has no rows if the
    reward is a success bit. `index [C, N]` lists row numbers: `counts [N, 2]` of them for each controller, of which the
    first `demos [2]` are demonstrations. `row []` is the next free row, `first_row []` the first row after the
    demonstrations. If transitions are evicted, `oldest [N, 2]` is the place of each controller's oldest own row in its
    ring, and `index` has another length; otherwise `oldest` is [N, 0].
    """

    state: jax.Array
    action: jax.Array
    flags: jax.Array
    reward: jax.Array
    index: jax.Array
    counts: jax.Array
    demos: jax.Array
    row: jax.Array
    first_row: jax.Array
    oldest: jax.Array

    @property
    def capacity(self) -> int:
        """Number of rows of transitions."""
        return self.action.shape[0]

    @property
    def evicts(self) -> bool:
        """Whether a new transition replaces the oldest one."""
        return self.oldest.shape[1] > 0

    @property
    def kept(self) -> jax.Array:
        """Number of a lane's own transitions, for all controllers together, that a replay keeps if it evicts others."""
        return self.capacity - self.first_row - 1

    def successor(self, row: jax.Array) -> jax.Array:
        """Return the row [...] of the state that follows the state in `row [...]`."""
        return jnp.where(row + 1 == self.capacity, self.first_row, row + 1) if self.evicts else row + 1

    def slot(self, number: jax.Array, lane: jax.Array, controller: jax.Array) -> jax.Array:
        """Return the places [...] in `index` of the `number`-th entries of the lists of `controller`, oldest first."""
        if self.evicts:
            demos = self.demos[controller]
            in_ring = demos + (self.oldest[lane, controller] + number - demos) % self.kept
            number = jnp.where(number < demos, number, in_ring)
        return jnp.where(controller == 0, number, len(self.index) - 1 - number)


def create(
    capacity: int, lanes: int, state_size: int, action_size: int, sparse: bool, slots: int | None = None
) -> Replay:
    """Return an empty buffer; goals are packed into 16 bits, so a goal table can have up to 65,536 entries.

    With `slots`, the length of both lists, transitions are evicted.
    """
    return Replay(
        state=jnp.zeros((capacity + 1, lanes, state_size)),
        action=jnp.zeros((capacity, lanes, action_size)),
        flags=jnp.zeros((capacity, lanes), jnp.int32),
        reward=jnp.zeros((0 if sparse else capacity, lanes)),
        index=jnp.zeros((capacity if slots is None else slots, lanes), jnp.int32),
        counts=jnp.zeros((lanes, CONTROLLERS), jnp.int32),
        demos=jnp.zeros((CONTROLLERS,), jnp.int32),
        row=jnp.zeros((), jnp.int32),
        first_row=jnp.zeros((), jnp.int32),
        oldest=jnp.zeros((lanes, 0 if slots is None else CONTROLLERS), jnp.int32),
    )


def pack(flags: TransitionFlags) -> jax.Array:
    """Return `flags` packed into int32 words."""
    bits = sum(bit * flag for bit, flag in zip(FLAG_BITS, flags[1:], strict=True))
    return flags.goal.astype(jnp.int32) | jnp.asarray(bits, jnp.int32)


def unpack(words: jax.Array) -> TransitionFlags:
    """Return the flags that are packed into the int32 `words`."""
    return TransitionFlags(words & (FLAG_BITS[0] - 1), *[(words & bit) != 0 for bit in FLAG_BITS])


@jax.named_scope("store")
def write(replay: Replay, transition: Transition, valid: jax.Array, controller: jax.Array) -> Replay:
    """Return the replay with one more transition for each lane, listed for `controller [N]` where `valid [N]`.

    After a reset, `transition.next_state` is the new start; the successor before the reset is not stored.
    """
    row, lanes = replay.row, jnp.arange(valid.shape[0])
    following = replay.successor(row)
    replay = _without_row(replay, following) if replay.evicts else replay

    def put(buffer, values, at_row):
        return jax.lax.dynamic_update_slice(buffer, values[None], (at_row,) + (0,) * values.ndim)

    filled = replay.counts[lanes, controller]
    slot = jnp.where(valid, replay.slot(filled, lanes, controller), len(replay.index))
    return replay.replace(
        state=put(replay.state, transition.next_state, following),
        action=put(replay.action, transition.action, row),
        flags=put(replay.flags, pack(transition.flags), row),
        reward=put(replay.reward, transition.reward, row) if replay.reward.shape[0] else replay.reward,
        index=replay.index.at[slot, lanes].set(row, mode="drop"),
        counts=replay.counts.at[lanes, controller].add(valid.astype(jnp.int32)),
        row=following,
    )


def _without_row(replay: Replay, row: jax.Array) -> Replay:
    """Return the replay without the oldest transition, which is in `row []`; its state is about to be overwritten."""
    lane, controller = jnp.arange(len(replay.counts))[:, None], jnp.arange(CONTROLLERS)[None]
    own = replay.counts - replay.demos
    oldest = replay.index[replay.slot(jnp.broadcast_to(replay.demos, own.shape), lane, controller), lane]
    evicted = (own > 0) & (oldest == row)
    return replay.replace(oldest=(replay.oldest + evicted) % replay.kept, counts=replay.counts - evicted)


@jax.named_scope("sample")
def sample(
    replay: Replay,
    keys: jax.Array,
    controller: jax.Array,
    size: int,
    demo_share: jax.Array,
    later_steps: float = 0,
    only_own: jax.Array | bool = False,
) -> TransitionBatch:
    """Return `size` transitions for each lane, drawn uniformly with replacement from those listed for `controller [N]`.

    A share `demo_share [N]` is drawn from the demonstrations alone. Where `only_own []` is true, the rest is drawn from
    own transitions alone, if there are any. At its first step, a controller without listed transitions samples those of the
    other controller. A lane's draw depends only on its own key and counts, not on the number of lanes. With
    `later_steps`, the batch has states `later` that many steps later on average.
    """
    lanes = jnp.arange(controller.shape[0])[:, None]
    controller = jnp.where(replay.counts[lanes[:, 0], controller] > 0, controller, 1 - controller)
    draw = jax.vmap(_draw, (0, 0, 0, 0, 0, None))
    counts, demos = replay.counts[lanes[:, 0], controller], replay.demos[controller]
    left_out = jnp.where(only_own & (counts > demos), demos, 0)
    listed = draw(keys, counts, demos, left_out, demo_share, size)
    batch = _read(replay, replay.index[replay.slot(listed, lanes, controller[:, None]), lanes])
    if not later_steps:
        return batch
    later_keys = jax.vmap(lambda key: jax.random.fold_in(key, 1))(keys)
    return batch._replace(later=later_states(replay, later_keys, batch.row, later_steps))


def sample_own(replay: Replay, keys: jax.Array, controller: int, size: int) -> TransitionBatch:
    """Return `size` of the `controller`'s own transitions for each lane, drawn uniformly with replacement.

    Demonstrations are excluded. Where the controller has none, the rows are others, and `demonstrated` is true.
    """
    lanes = jnp.arange(len(keys))[:, None]
    demos, own = replay.demos[controller], replay.counts[:, controller] - replay.demos[controller]
    listed = jax.vmap(lambda key, count: jax.random.randint(key, (size,), 0, jnp.maximum(count, 1)))(keys, own) + demos
    rows = replay.index[replay.slot(listed, lanes, jnp.full_like(lanes, controller)), lanes]
    return _read(replay, rows)._replace(demonstrated=jnp.broadcast_to((own == 0)[:, None], rows.shape))


def _read(replay: Replay, rows: jax.Array) -> TransitionBatch:
    """Return the transitions of `rows [N, B]`."""
    lanes = jnp.arange(len(rows))[:, None]
    flags = unpack(replay.flags[rows, lanes])
    success = (flags.reached | flags.passed).astype(jnp.float32)
    reward = replay.reward[rows, lanes] if replay.reward.shape[0] else success
    state, action = replay.state[rows, lanes], replay.action[rows, lanes]
    following = replay.state[replay.successor(rows), lanes]
    return TransitionBatch(rows, state, action, following, reward, flags, demonstrated=rows < replay.first_row)


def later_states(replay: Replay, keys: jax.Array, rows: jax.Array, mean_steps: float) -> jax.Array:
    """Return states [N, B, s] that follow those of `rows [N, B]` after a geometric number of steps, 1 or more.

    A draw beyond the newest state, or beyond the last demonstrated one, returns that state. States can lie beyond a
    reset or the end of a demonstration, because values are learnt for any goal. Cloning instead needs a later state of
    the same demonstration.
    """
    draw = jax.vmap(lambda key: jax.random.geometric(key, 1.0 / mean_steps, rows.shape[1:]))
    first, size = replay.first_row, replay.capacity - replay.first_row
    own = rows >= first
    most = jnp.where(own, (replay.row - rows) % size if replay.evicts else replay.row - rows, first - 1 - rows)
    following = rows + jnp.minimum(draw(keys), most)
    if replay.evicts:
        following = jnp.where(own, first + (following - first) % size, following)
    return replay.state[following, jnp.arange(len(rows))[:, None]]


def _draw(
    key: jax.Array, count: jax.Array, demos: jax.Array, left_out: jax.Array, demo_share: jax.Array, size: int
) -> jax.Array:
    """Return random indices [size] into one lane's list of `count` rows.

    A `demo_share` is drawn from the first `demos` rows, the rest from the rows after the first `left_out`. Integers are
    drawn, because float32 cannot represent all integers beyond 2**24.
    """
    share_key, index_key = jax.random.split(key)
    from_demos = (jax.random.uniform(share_key, (size,)) < demo_share) & (demos > 0)
    first, last = jnp.where(from_demos, 0, left_out), jnp.where(from_demos, demos, count)
    return first + jax.random.randint(index_key, (size,), 0, jnp.maximum(last - first, 1))
