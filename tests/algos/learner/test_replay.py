"""The replay: written in place, and sampled by the controller that a transition belongs to."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.algos.learner import replay
from earl_jax.algos.learner.replay import Transition, TransitionFlags
from earl_jax.runs import snapshot
from earl_jax.training.scan import run_steps
from tests.conftest import assert_equal_trees, make_train_state, tiny_method

KEYS = jax.random.split(jax.random.key(0), 2)
NO_DEMO_SHARE = np.zeros(2, np.float32)
DRAWS = 200
# Each is one program; called eagerly, every operation would be one.
sample = jax.jit(replay.sample, static_argnums=3)
write = jax.jit(replay.write)
later_states = jax.jit(replay.later_states, static_argnums=3)


def make_transition(step):
    """Return a transition of two lanes whose every field shows its step and lane."""
    number = (np.arange(2) + 10.0 * step).astype(np.float32)
    no = np.zeros(2, bool)
    flags = TransitionFlags(np.full(2, step, np.int32), no, no, no, no)
    return Transition(action=number[:, None], next_state=number[:, None] + 1000, reward=number, flags=flags)


def fill_replay(controllers, valid, buffer=None, first=0):
    buffer = replay.create(len(controllers), 2, 1, 1, False) if buffer is None else buffer
    for step, (controller, keep) in enumerate(zip(controllers, valid, strict=True), first):
        buffer = write(buffer, make_transition(step), np.array(keep), np.array(controller, np.int32))
    return buffer


def test_unpacking_inverts_packing():
    goals = jnp.array([0, 1, 65535])
    bits = [jnp.array([number & 1, number & 2, number & 4], bool) for number in range(1, 6)]
    flags = TransitionFlags(goals, *bits)
    assert_equal_trees(replay.unpack(replay.pack(flags)), flags)


def test_a_controller_without_rows_samples_those_of_the_other():
    buffer = fill_replay([(0, 1), (0, 1)], [(True, True)] * 2)
    batch = sample(buffer, KEYS, np.array([1, 0], np.int32), DRAWS, NO_DEMO_SHARE)
    assert [set(rows.tolist()) for rows in batch.row] == [{0, 1}] * 2


def test_sampling_is_uniform_but_for_a_share_of_demonstrations():
    buffer = fill_replay([(0, 0)] * 8, [(True, True)] * 8).replace(demos=np.array([2, 0], np.int32))
    rows = np.asarray(sample(buffer, KEYS, np.zeros(2, np.int32), 8000, np.float32([0.5, 0.0])).row)
    assert abs((rows[0] < 2).mean() - (0.5 + 0.5 * 0.25)) < 0.02
    assert np.abs(np.bincount(rows[1], minlength=8) - 1000).max() < 150


def kept_steps(buffer, controller, lane):
    """Return the steps of `make_transition` that `controller` samples in `lane`, whose rows must be consistent."""
    batch = sample(buffer, KEYS, np.full(2, controller, np.int32), DRAWS, NO_DEMO_SHARE)
    action = np.asarray(batch.action[lane, :, 0])
    np.testing.assert_allclose(batch.next_state[lane, :, 0], action + 1000)
    np.testing.assert_allclose(batch.state[lane, :, 0], np.where(action < 10, 0, action + 990))
    np.testing.assert_allclose(batch.reward[lane], action)
    np.testing.assert_array_equal(batch.flags.goal[lane], (action - lane) / 10)
    return set(batch.flags.goal[lane].tolist())


RNG = np.random.default_rng(0)
LONG = RNG.integers(2, size=(30, 2)), RNG.random((30, 2)) < 0.8
"""Controllers and validity [30, 2] of thirty steps of two lanes."""


@pytest.mark.parametrize(("length", "capacity"), [(3, 4), (4, 4), (5, 4), (9, 4), (30, 4), (30, 30)])
def test_each_controller_samples_its_own_valid_transitions_the_newest_with_a_capacity(length, capacity):
    controllers, valid = LONG[0][:length], LONG[1][:length]
    buffer = fill_replay(controllers, valid, buffer=None if capacity == 30 else ring(capacity))
    newest = np.arange(length) >= length - capacity
    for controller, lane in itertools.product(range(2), range(2)):
        steps = np.flatnonzero(newest & valid[:, lane] & (controllers[:, lane] == controller))
        assert buffer.counts[lane, controller] == len(steps)
        if len(steps):
            assert kept_steps(buffer, controller, lane) == set(steps.tolist())


def with_demonstrations(own):
    """Return a replay of `own` transitions after a demonstration of 2 steps, 3 states, which controller 0 lists."""
    buffer = replay.create(3 + own + 1, 2, 1, 1, False, slots=2 + own)
    two = jnp.full((2, 2), 2).at[:, 1].set(0)
    return buffer.replace(
        index=buffer.index.at[1].set(1), counts=two, demos=two[0], row=jnp.asarray(3), first_row=jnp.asarray(3)
    )


def test_a_replay_with_a_capacity_keeps_its_demonstrations():
    buffer = fill_replay([(0, 0)] * 11, [(True, True)] * 11, buffer=with_demonstrations(3))
    batch = sample(buffer, KEYS, np.zeros(2, np.int32), DRAWS, NO_DEMO_SHARE)
    rows, steps = np.asarray(batch.row[0]), np.asarray(batch.flags.goal[0])
    assert set(rows[rows < 3].tolist()) == {0, 1}
    assert set(steps[rows >= 3].tolist()) == {8, 9, 10}
    np.testing.assert_allclose(batch.next_state[0, rows >= 3, 0], 1000 + 10.0 * steps[rows >= 3])


@pytest.mark.parametrize("own", [3, 0])
def test_demonstrations_are_left_out_of_a_sample_of_own_transitions_if_there_are_any_but_not_out_of_their_share(own):
    buffer = fill_replay([(0, 0)] * own, [(True, True)] * own, buffer=with_demonstrations(3))
    for share, rest in ((0, set()), (0.5, {0, 1}), (1, {0, 1})):
        batch = sample(buffer, KEYS, np.zeros(2, np.int32), DRAWS, np.full(2, share, np.float32), only_own=np.True_)
        expected = rest | ({3, 4, 5} if share < 1 else set()) if own else {0, 1}
        assert set(np.asarray(batch.row).ravel().tolist()) == expected


def ring(own):
    """Return an empty replay that keeps `own` transitions."""
    return replay.create(own + 1, 2, 1, 1, False, slots=2 * own)


@pytest.mark.parametrize("length", [3, 4, 5, 30])
def test_a_replay_that_evicts_is_saved_and_restored(length):
    buffer = fill_replay(LONG[0][:length], LONG[1][:length], buffer=ring(4))
    saved = snapshot.filled(buffer, slice(None), length)
    assert_equal_trees(snapshot.spread([saved], [2], ring(4)), buffer)
    assert len(saved["action"]) == min(length, 5), "rows, of which the last has no transition"


def test_a_replay_of_a_short_run_is_restored_in_one_that_evicts():
    """As `resume` with more steps does."""
    rows, more = (LONG[0][:6], LONG[1][:6]), (LONG[0][6:], LONG[1][6:])
    short = fill_replay(*rows)
    grown = jax.tree.map(jnp.asarray, snapshot.spread([snapshot.filled(short, slice(None), 6)], [2], ring(7)))
    buffers = fill_replay(*more, buffer=grown, first=6), fill_replay(*LONG, buffer=ring(7))
    for controller in np.eye(2, dtype=np.int32):
        assert_equal_trees(*(sample(buffer, KEYS, controller, DRAWS, NO_DEMO_SHARE) for buffer in buffers))


@pytest.mark.parametrize("capacity", [None, pytest.param(50_000, marks=pytest.mark.slow)])
def test_no_step_copies_the_buffer(problem, capacity):
    """The buffer enters as a donated argument, as it does after a resume; a hidden copy would be ten times the bound."""
    method = tiny_method("fbrl", **({} if capacity is None else {"replay_capacity": capacity}))
    state = jax.eval_shape(lambda: make_train_state(problem, method, [0, 1], steps=200_000))
    run = jax.jit(lambda m, state: run_steps(problem, m, state, 20), donate_argnums=1)
    memory = run.lower(method, state).compile().memory_analysis()
    buffer_bytes = sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(state.replay))
    assert buffer_bytes > (10_000_000 if capacity is None else 8_000_000)
    assert memory.temp_size_in_bytes < buffer_bytes / 10
    assert memory.alias_size_in_bytes > buffer_bytes


@pytest.mark.parametrize("evicts", [False, True])
def test_later_states_are_some_steps_after_the_sampled_ones(evicts):
    demos, capacity = 5, 25 if evicts else 40
    buffer = replay.create(capacity, 2, 1, 1, False, slots=capacity if evicts else None)
    state, first = buffer.state.at[:demos].set(jnp.arange(demos)[:, None, None] - 100.0), jnp.asarray(demos)
    buffer = fill_replay([(0, 0)] * 30, [(True, True)] * 30, buffer.replace(state=state, row=first, first_row=first))
    newest = buffer.row - 1 if int(buffer.row) > demos else jnp.asarray(capacity - 1)
    rows = jnp.concatenate([jnp.full((2, 2000), newest - 4), jnp.full((2, 2000), 1)], axis=1)
    later = later_states(buffer, KEYS, rows, 3.0)[0, :, 0]
    ahead = (later[:2000] - buffer.state[newest - 4, 0, 0]) / 10
    assert set(np.unique(ahead)) == {1, 2, 3, 4, 5}
    np.testing.assert_allclose((ahead == 1).mean(), 1 / 3, atol=0.05)
    assert set(np.unique(later[2000:])) == {-98, -97, -96}, "a demonstrated state stays among the demonstrations"
