"""What is known of the tasks: corrections of hand and peg, moves of tabletop, and which task has which knowledge."""

import dataclasses

import jax
import numpy as np
import pytest

import earl_jax
from earl_jax.envs.tabletop import TabletopOrganization
from earl_jax_cfbrl.tasks import knowledge_of

KEY = jax.random.key(3)
PEG = knowledge_of(earl_jax.make("sawyer_peg"))
HEAD, GRIPPER = slice(4, 7), 3


def corrections(state, action, change):
    """Return 500 corrections of a step from `state [7]` that moves hand and peg by `change [7]`, as NumPy arrays."""
    state, change = np.float32(state), np.float32(change)
    draw = jax.jit(jax.vmap(lambda key: PEG.correction(key, state, np.float32(action), state + change)))
    return jax.device_get(draw(jax.random.split(KEY, 500)))


def is_clear(points, margin):
    """Return which `points [B, 3]` are in front of the block or keep `margin` [m] from its sides."""
    return (points[:, 0] > -0.18) | (np.abs(points[:, 1] - 0.6) > 0.1 + margin - 0.01)


@dataclasses.dataclass(frozen=True)
class Meadow(TabletopOrganization):
    """A task of another package, on the table."""


KNOWLEDGE = {
    "peg": (PEG.env, True, True, True),
    "peg without its gripper": (earl_jax.make("sawyer_peg", variant="paper"), True, False, False),
    "peg with a budget": (earl_jax.HelpBudget(PEG.env, budget=5.0), False, False, False),
    "door": (earl_jax.make("sawyer_door"), True, False, False),
    "tabletop": (earl_jax.make("tabletop_organization"), False, True, False),
    "tabletop with goals of the mug": (earl_jax.make("tabletop_organization", mug_only=True), True, True, False),
    "subclass": (Meadow(), False, True, False),
    "minitaur": (earl_jax.make("minitaur_pen"), False, False, False),
}
"""Tasks, and whether goals from states, translations and corrections are known of them."""


@pytest.mark.parametrize("name", KNOWLEDGE)
def test_a_task_has_the_knowledge_of_its_class_and_others_have_none(name):
    env, *expected = KNOWLEDGE[name]
    known, state, action = knowledge_of(env), np.zeros(env.state_size), np.zeros(env.action_size)
    goal, offset, correction = jax.eval_shape(
        lambda: (
            known.goal_from(state),
            known.translation(KEY, state, state),
            known.correction(KEY, state, action, state),
        )
    )
    assert [part is not None for part in (goal, offset, correction)] == expected
    assert goal is None or goal.shape == (env.goal_size,)
    assert offset is None or offset.shape == (env.state_size,)
    assert correction is None or correction.action.shape == (env.action_size,)


def test_a_move_of_the_peg_shifts_hand_and_peg_alike_and_stays_clear_of_the_block():
    demos = PEG.env.demonstrations.load("forward")
    keys = jax.random.split(KEY, len(demos.ends))
    offset = np.asarray(jax.jit(jax.vmap(PEG.translation))(keys, demos.states, demos.next_states))
    np.testing.assert_array_equal(offset[:, :2], offset[:, 4:6])
    np.testing.assert_array_equal(np.delete(offset, [0, 1, 4, 5], axis=1), 0.0)
    changed = (offset != 0).any(axis=1)
    assert 0.2 < changed.mean() < 0.9
    for state in (demos.states[changed] + offset[changed], demos.next_states[changed] + offset[changed]):
        assert (is_clear(state[:, HEAD], 0.025) & is_clear(state[:, :3], 0.06)).all()
    inserted = demos.next_states[:, 4] < -0.2
    assert inserted.any()
    assert not changed[inserted].any(), "the block takes part in an insertion"


def test_a_free_hand_is_led_back_and_opens_and_to_a_peg_beside_the_block_around_it():
    state = [0.0, 0.65, 0.2, 1.0, 0.1, 0.6, 0.02]
    steps = corrections(state, [0.0, 0.0, 0.0, -1.0], np.zeros(7))
    assert steps.approach.all()
    around = (steps.state[:, HEAD] != np.float32(state[4:])).any(axis=1)
    assert 0.15 < around.mean() < 0.35
    offset, action = np.float32(state[:3]) - steps.state[:, :3], steps.action
    np.testing.assert_allclose((steps.next_state - steps.state)[:, :3], 0.008 * action[:, :3], atol=1e-6)
    far = ~around & (np.linalg.norm(offset, axis=1) > 0.1)
    assert 0.2 < far.mean() < 0.9
    along = (action[far, :3] * offset[far]).sum(axis=1) / np.linalg.norm(offset[far], axis=1)
    assert (along > 0.8).all()
    assert (steps.state[:, GRIPPER] < 0.9).any()
    assert (action[:, GRIPPER] == -1).all()
    hand, head, action = steps.state[around, :3], steps.state[around, HEAD], action[around]
    side = np.sign(head[:, 1] - 0.6)
    assert ((head[:, 0] < -0.3) & (side * (head[:, 1] - 0.6) > 0.12)).all()
    beside = side * (hand[:, 1] - 0.6) >= 0.16
    assert 0.1 < beside.mean() < 0.9
    assert (hand[~beside, 0] + 0.01 * action[~beside, 0] > -0.18).all(), "it does not move against the block"
    assert (action[~beside, 1] * side[~beside] > 0).all(), "it moves to the side on which the peg lies"


def test_a_carried_peg_is_led_back_along_x_first_from_beside_the_block():
    state = [0.24, 0.6, 0.125, 0.3, 0.1, 0.6, 0.1]
    steps = corrections(state, [0.0, 0.0, 0.0, 1.0], np.zeros(7))
    moved = ~steps.approach
    assert moved.mean() > 0.6
    offset = (steps.state - np.float32(state))[moved]
    np.testing.assert_allclose(offset[:, :3], offset[:, HEAD], atol=1e-6)
    head, action = steps.state[moved, HEAD], steps.action[moved]
    assert (is_clear(head, 0.025) & is_clear(steps.state[moved, :3], 0.06)).all()
    assert (action[:, GRIPPER] == 1).all()
    beside = (head[:, 0] < -0.14) & (np.abs(head[:, 1] - 0.6) > 0.12)
    assert beside.sum() > 5
    np.testing.assert_allclose(action[beside, 1], 0.0, atol=1e-6)
    assert (action[beside, 0] > 0).all()
    far = (head[:, 0] > -0.13) & (np.linalg.norm(offset[:, :3], axis=1) > 0.1)
    along = -(action[far, :3] * offset[far, :3]).sum(axis=1) / np.linalg.norm(offset[far, :3], axis=1)
    assert (along > 0.8).all()


def test_the_dynamics_of_tabletop_are_the_same_after_a_move():
    env = earl_jax.make("tabletop_organization")

    def move(key):
        start_key, action_key, offset_key = jax.random.split(key, 3)
        start = env.starts.uniform(start_key)
        action = jax.random.uniform(action_key, (3,), minval=-1.0)
        state, following = start.obs[:6], env.step(start, action).obs[:6]
        offset = knowledge_of(env).translation(offset_key, state, following)
        moved = env.step(env.demonstrations.state_at(state + offset, start.info["goal"]), action).obs[:6]
        return following, offset, moved

    following, offset, moved = jax.device_get(jax.jit(jax.vmap(move))(jax.random.split(KEY, 400)))
    np.testing.assert_allclose(moved, following + offset, atol=1e-5)
    changed, at_wall = (offset != 0).any(axis=1), (np.abs(following[:, :4]) >= 2.8).any(axis=1)
    assert 0.1 < changed.mean() < 0.9
    assert at_wall.any()
    assert not changed[at_wall].any()
