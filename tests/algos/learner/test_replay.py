"""The replay: written in place, and sampled by the controller that a transition belongs to."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.algos.learner import replay
from earl_jax.algos.learner.replay import Transition, TransitionFlags
from earl_jax.training.scan import run_steps
from tests.conftest import make_train_state, tiny_method

KEYS = jax.random.split(jax.random.key(0), 2)
NO_DEMO_SHARE = jnp.zeros(2)


def make_transition(step, lanes=2):
    """Return a transition whose every field shows its step and lane."""
    number = jnp.arange(lanes) + 10.0 * step
    no = jnp.zeros(lanes, bool)
    reached = no.at[0].set(step % 2 == 0)
    flags = TransitionFlags(goal=jnp.full(lanes, step), reached=reached, timeout=no, no_successor=no, absorbed=no)
    return Transition(action=number[:, None], next_state=number[:, None] + 1000, reward=number, flags=flags)


def fill_replay(controllers, valid, sparse=False):
    buffer = replay.create(len(controllers), 2, 1, 1, sparse)
    for step, (controller, keep) in enumerate(zip(controllers, valid, strict=True)):
        buffer = replay.write(buffer, make_transition(step), jnp.array(keep), jnp.array(controller))
    return buffer


def test_unpacking_inverts_packing():
    goals = jnp.array([0, 1, 65535])
    bits = [jnp.array([a, b, a != b]) for a, b in ((True, False), (False, False), (True, True), (False, True))]
    unpacked = replay.unpack(replay.pack(TransitionFlags(goals, *bits)))
    np.testing.assert_array_equal(unpacked.goal, goals)
    for actual, expected in zip(unpacked[1:], bits, strict=True):
        np.testing.assert_array_equal(actual, expected)


def test_each_controller_samples_its_own_valid_rows():
    controllers = [(0, 1), (1, 1), (0, 0), (1, 0), (0, 1)]
    valid = [(True, True), (True, True), (False, True), (True, True), (True, False)]
    buffer = fill_replay(controllers, valid)
    for controller, expected in ((0, [{0, 4}, {2, 3}]), (1, [{1, 3}, {0, 1}])):
        batch = replay.sample(buffer, KEYS, jnp.full(2, controller), 200, NO_DEMO_SHARE)
        for lane in range(2):
            row = np.asarray(batch.row[lane])
            assert set(row.tolist()) == expected[lane]
            np.testing.assert_allclose(batch.action[lane, :, 0], 10 * row + lane)
            np.testing.assert_allclose(batch.next_state[lane, :, 0], 10 * row + lane + 1000)
            np.testing.assert_allclose(batch.state[lane, :, 0], np.where(row == 0, 0, 990 + 10 * row + lane))
            np.testing.assert_allclose(batch.reward[lane], 10 * row + lane)
            np.testing.assert_array_equal(batch.flags.goal[lane], row)


def test_a_controller_without_rows_samples_those_of_the_other():
    buffer = fill_replay([(0, 1), (0, 1)], [(True, True)] * 2)
    batch = replay.sample(buffer, KEYS, jnp.array([1, 0]), 50, NO_DEMO_SHARE)
    for lane in range(2):
        assert {int(row) for row in batch.row[lane]} == {0, 1}


def test_a_sparse_reward_is_the_success_bit():
    buffer = fill_replay([(0, 0)] * 4, [(True, True)] * 4, sparse=True)
    batch = replay.sample(buffer, KEYS, jnp.zeros(2, int), 100, NO_DEMO_SHARE)
    np.testing.assert_array_equal(batch.reward[0], batch.row[0] % 2 == 0)
    assert not batch.reward[1].any()


def test_sampling_is_uniform():
    buffer = fill_replay([(0, 0)] * 8, [(True, True)] * 8)
    batch = replay.sample(buffer, KEYS, jnp.zeros(2, int), 8000, NO_DEMO_SHARE)
    counts = np.bincount(np.asarray(batch.row[0]), minlength=8)
    assert np.abs(counts - 1000).max() < 150


def test_a_share_of_the_batch_comes_from_the_demonstrations():
    buffer = fill_replay([(0, 0)] * 8, [(True, True)] * 8).replace(demos=jnp.array([2, 0]))
    batch = replay.sample(buffer, KEYS, jnp.zeros(2, int), 8000, jnp.array([0.5, 0.0]))
    assert abs((batch.row[0] < 2).mean() - (0.5 + 0.5 * 0.25)) < 0.02
    assert abs((batch.row[1] < 2).mean() - 0.25) < 0.02


def total_bytes(tree):
    return sum(leaf.nbytes for leaf in jax.tree.leaves(tree))


@pytest.mark.parametrize("sparse", [True, False])
def test_bytes_per_transition_are_those_of_the_arrays(sparse):
    small, large = (replay.create(size, 3, 6, 3, sparse) for size in (100, 300))
    assert total_bytes(large) - total_bytes(small) == 200 * 3 * replay.bytes_per_transition(6, 3, sparse)


def test_no_step_copies_the_buffer(problem):
    """The buffer enters as a donated argument, as it does after a resume; a hidden copy would be ten times the bound."""
    method = tiny_method("fbrl")
    state = make_train_state(problem, method, [0, 1], steps=200_000)
    run = jax.jit(lambda m, state: run_steps(problem, m, state, 20), donate_argnums=1)
    memory = run.lower(method, state).compile().memory_analysis()
    buffer_bytes = total_bytes(state.replay)
    assert buffer_bytes > 10_000_000
    assert memory.temp_size_in_bytes < buffer_bytes / 10
    assert memory.alias_size_in_bytes > buffer_bytes
