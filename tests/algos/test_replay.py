"""The replay: what is written is what is sampled, in place, by the controller it belongs to."""

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.algos.learner import replay
from earl_jax.algos.learner.replay import TransitionFlags, Transition
from earl_jax.training import loop as autonomy
from tests.conftest import newborn, tiny_method

NONE = jnp.zeros(2)


def transition(step, lanes=2):
    """A transition whose every field tells its step and lane."""
    number = jnp.arange(lanes) + 10.0 * step
    flags = jnp.zeros(lanes, bool)
    flags = TransitionFlags(jnp.full(lanes, step), flags.at[0].set(step % 2 == 0), flags, flags, flags)
    return Transition(number[:, None], number[:, None] + 1000, number, flags)


def filled(controllers, valid, sparse=False):
    buffer = replay.create(len(controllers), 2, 1, 1, sparse)
    for step, (controller, keep) in enumerate(zip(controllers, valid, strict=True)):
        buffer = replay.write(buffer, transition(step), jnp.array(keep), jnp.array(controller))
    return buffer


def test_marks_survive_packing():
    goals = jnp.array([0, 1, 65535])
    bits = [jnp.array([a, b, a != b]) for a, b in ((True, False), (False, False), (True, True), (False, True))]
    back = replay.unpack(replay.pack(TransitionFlags(goals, *bits)))
    np.testing.assert_array_equal(back.goal, goals)
    for got, want in zip(back[1:], bits, strict=True):
        np.testing.assert_array_equal(got, want)


def test_each_controller_samples_its_own_valid_rows():
    controllers = [(0, 1), (1, 1), (0, 0), (1, 0), (0, 1)]
    valid = [(True, True), (True, True), (False, True), (True, True), (True, False)]
    buffer = filled(controllers, valid)
    for controller, expected in ((0, [{0, 4}, {2, 3}]), (1, [{1, 3}, {0, 1}])):
        rows = replay.sample(buffer, jax.random.split(jax.random.key(0), 2), jnp.full(2, controller), 200, NONE)
        for lane in range(2):
            assert {int(row) for row in rows.row[lane]} == expected[lane]
            np.testing.assert_allclose(rows.action[lane, :, 0], 10 * rows.row[lane] + lane)
            np.testing.assert_allclose(rows.next_state[lane, :, 0], 10 * rows.row[lane] + lane + 1000)
            np.testing.assert_allclose(
                rows.state[lane, :, 0], np.where(rows.row[lane] == 0, 0, 990 + 10 * rows.row[lane] + lane)
            )
            np.testing.assert_allclose(rows.reward[lane], 10 * rows.row[lane] + lane)
            np.testing.assert_array_equal(rows.flags.goal[lane], rows.row[lane])


def test_a_controller_without_a_row_of_its_own_is_given_the_others():
    buffer = filled([(0, 1), (0, 1)], [(True, True)] * 2)
    rows = replay.sample(buffer, jax.random.split(jax.random.key(0), 2), jnp.array([1, 0]), 50, NONE)
    for lane in range(2):
        assert {int(row) for row in rows.row[lane]} == {0, 1}


def test_a_sparse_reward_is_the_success_bit():
    buffer = filled([(0, 0)] * 4, [(True, True)] * 4, sparse=True)
    rows = replay.sample(buffer, jax.random.split(jax.random.key(0), 2), jnp.zeros(2, int), 100, NONE)
    np.testing.assert_array_equal(rows.reward[0], rows.row[0] % 2 == 0)
    assert not rows.reward[1].any()


def test_sampling_is_uniform():
    buffer = filled([(0, 0)] * 8, [(True, True)] * 8)
    rows = replay.sample(buffer, jax.random.split(jax.random.key(0), 2), jnp.zeros(2, int), 8000, NONE)
    counts = np.bincount(np.asarray(rows.row[0]), minlength=8)
    assert np.abs(counts - 1000).max() < 150


def test_a_share_of_the_batch_comes_from_the_demonstrations():
    buffer = filled([(0, 0)] * 8, [(True, True)] * 8).replace(demos=jnp.array([2, 0]))
    share = jnp.array([0.5, 0.0])
    rows = replay.sample(buffer, jax.random.split(jax.random.key(0), 2), jnp.zeros(2, int), 8000, share)
    assert abs((rows.row[0] < 2).mean() - (0.5 + 0.5 * 0.25)) < 0.02
    assert abs((rows.row[1] < 2).mean() - 0.25) < 0.02


def test_bytes_per_transition_are_what_create_takes():
    for sparse in (True, False):
        small, large = (replay.create(size, 3, 6, 3, sparse) for size in (100, 300))
        grown = sum(leaf.nbytes for leaf in jax.tree.leaves(large)) - sum(
            leaf.nbytes for leaf in jax.tree.leaves(small)
        )
        assert grown == 200 * 3 * replay.bytes_per_transition(6, 3, sparse)


def test_no_step_copies_the_buffer(problem):
    """The buffer enters as a donated argument, as it does after a resume; a hidden copy would be ten times the bound."""
    method = tiny_method("fbrl")
    lives = newborn(problem, method, [0, 1], steps=200_000)
    program = (
        jax.jit(lambda m, state: autonomy.run(problem, m, state, 20), donate_argnums=1).lower(method, lives).compile()
    )
    buffer = sum(leaf.nbytes for leaf in jax.tree.leaves(lives.replay))
    memory = program.memory_analysis()
    assert buffer > 10_000_000
    assert memory.temp_size_in_bytes < buffer / 10
    assert memory.alias_size_in_bytes > buffer
