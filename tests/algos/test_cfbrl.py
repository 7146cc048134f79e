"""CFBRL: hindsight goals, moved transitions, what of them is cloned, the warm-up, and exploration of stuck phases."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.algos import cfbrl, make_algo
from earl_jax.algos.cfbrl import Steps
from earl_jax.algos.goals import goal_table
from earl_jax.algos.learner import sac
from earl_jax.algos.learner.replay import TransitionBatch, TransitionFlags
from earl_jax.algos.method import TASK
from earl_jax.envs import make
from earl_jax.envs.sawyer.experts import peg_grasp
from earl_jax.training.init import demonstrations
from tests.algos.lives import lived
from tests.conftest import CHUNK, make_problem, tiny_train

KEY = jax.random.key(3)
PEG = make("sawyer_peg")
HEAD, GRIPPER = slice(4, 7), 3


def demonstrated_rows():
    """Return the demonstrated forward steps of the peg, whose later states are 20 steps ahead or the last one."""
    demos = PEG.demos("forward")
    last = np.flatnonzero(demos.ends)
    end = last[np.searchsorted(last, np.arange(len(demos.ends)))]
    later = demos.next_states[np.minimum(np.arange(len(end)) + 20, end)]
    return Steps(demos.states, demos.actions, demos.next_states, later, demos.goals)


ROWS = demonstrated_rows()
transform = jax.jit(lambda method, *arguments: method.transform(KEY, PEG, *arguments))
success = jax.jit(PEG.success)
relabel = jax.jit(lambda method, batch: method.relabel(KEY, PEG, goal_table(PEG), batch, TASK))


@functools.cache
def transformed(allowed=True, demonstrated=False, **shares):
    """Return the rows as NumPy arrays after the transformations with these shares, which ones changed, and which to clone."""
    method = make_algo("cfbrl", **{"hindsight": 0.0, "translated": 0.0, "corrected": 0.0, **shares})
    flags = [np.full(len(ROWS.state), flag) for flag in (allowed, demonstrated)]
    return jax.device_get(transform(method, ROWS, *flags))


def corrected_steps():
    return transformed(demonstrated=True, corrected=1.0)


def assert_clear_of_the_block(steps, moved):
    """Assert that heads keep 2.5 cm and hands 6 cm from the block's sides, where they are not in front of it."""
    states = np.concatenate([steps.state, steps.next_state])[np.tile(moved, 2)]
    for points, margin in ((states[:, HEAD], 0.025), (states[:, :3], 0.06)):
        assert not ((points[:, 0] < -0.17 - 0.01) & (np.abs(points[:, 1] - 0.6) < 0.1 + margin - 0.01)).any()


def make_batch(row, state, next_state, later, no_successor):
    """Return transitions with the first goal, no action and no reward."""
    size = len(row)
    no = np.zeros(size, bool)
    flags = TransitionFlags(np.zeros(size, int), no, no, no_successor, no)
    action, reward = np.zeros((size, 4), np.float32), np.zeros(size, np.float32)
    return TransitionBatch(row, state, action, next_state, reward, flags, no, later)


def held_rows():
    """Return the steps, bool [B], in which the hand holds the peg outside of the hole."""
    held = (ROWS.state[:, GRIPPER] < 0.5) & (ROWS.action[:, 3] > 0) & (ROWS.next_state[:, 4] > -0.15)
    grasps = np.asarray(jax.jit(jax.vmap(peg_grasp))(ROWS.state[:, HEAD]))
    return held & (np.linalg.norm(ROWS.state[:, :3] - grasps, axis=1) < 0.03)


CARRIED = held_rows()


def is_around(steps):
    """Return which approaches, bool [B], a correction has moved to a peg beside the block."""
    head, before = steps.state[:, HEAD], ROWS.state[:, HEAD]
    return (head[:, :2] != before[:, :2]).any(axis=1) & ~CARRIED & (before[:, 0] > -0.2)


def distance(first, second):
    return np.linalg.norm(first[:, HEAD] - second[:, HEAD], axis=1)


def test_without_shares_and_where_it_is_not_allowed_nothing_changes():
    for steps, changed, to_clone in (transformed(), transformed(allowed=False, hindsight=1.0, translated=1.0)):
        assert not changed.any()
        assert to_clone.all()
        for new, old in zip(steps[:3], ROWS[:3], strict=True):
            np.testing.assert_array_equal(new, old)
        np.testing.assert_array_equal(steps.goal, ROWS.goal)


def test_a_hindsight_goal_is_the_object_of_a_later_state():
    steps, changed, to_clone = transformed(hindsight=1.0)
    assert changed.all()
    np.testing.assert_allclose(distance(steps.goal, ROWS.later), 0.0, atol=1e-7)
    np.testing.assert_array_equal(steps.goal[:, :4], np.broadcast_to(PEG.goal_states[0, :4], (len(steps.goal), 4)))
    ahead = distance(ROWS.state, ROWS.later) > 0.05
    assert 0.1 < ahead.mean() < 0.9
    np.testing.assert_array_equal(to_clone, ahead)


def test_a_move_shifts_hand_and_object_alike_and_stays_clear_of_the_block():
    steps, changed, to_clone = transformed(translated=1.0)
    offset = steps.state - ROWS.state
    np.testing.assert_allclose(offset[:, :2], offset[:, 4:6], atol=1e-6)
    np.testing.assert_allclose(steps.next_state - ROWS.next_state, offset, atol=1e-6)
    np.testing.assert_array_equal(np.delete(offset, [0, 1, 4, 5], axis=1), 0.0)
    np.testing.assert_array_equal(changed, (offset != 0).any(axis=1))
    assert 0.2 < changed.mean() < 0.9
    assert_clear_of_the_block(steps, changed)
    inserted = ROWS.next_state[:, 4] < -0.2
    assert inserted.any()
    assert not changed[inserted].any(), "the block takes part in an insertion"
    np.testing.assert_array_equal(to_clone, ~changed)


def test_a_corrected_step_leads_back_to_the_demonstrated_one():
    steps, changed, to_clone = corrected_steps()
    still = (distance(ROWS.state, ROWS.next_state) < 0.001) & ~CARRIED & ~is_around(steps)
    assert changed.all()
    lying = (ROWS.state[:, 4] > -0.2) & (steps.state[:, HEAD] == ROWS.state[:, HEAD]).all(1)
    assert lying[still].all()
    for new, old in zip(steps, ROWS, strict=True):
        np.testing.assert_array_equal(new[lying & ~still], old[lying & ~still])
    back = (ROWS.state - steps.state)[:, :3]
    far = (np.linalg.norm(back, axis=1) > 0.1) & lying
    assert 0.2 < far[still].mean() < 0.9
    action = steps.action
    along = (action[far, :3] * back[far]).sum(axis=1) / np.linalg.norm(back[far], axis=1)
    assert (along > 0.8).all()
    assert np.abs(action).max() <= 1.0
    closed = steps.state[:, GRIPPER] < ROWS.state[:, GRIPPER]
    assert closed[far].any()
    assert (action[closed, GRIPPER] < 0).all(), "a hand that is closed far from the peg opens"
    goals = {tuple(goal) for goal in steps.goal[still].round(4)}
    assert len(goals) > 2, "an approach serves every goal"
    at_goal = np.asarray(success(np.concatenate([steps.state, steps.goal], axis=-1)))
    np.testing.assert_array_equal(to_clone[still], ~at_goal[still])


def test_the_next_state_of_a_corrected_step_is_near_the_simulated_one():
    steps, _, _ = corrected_steps()
    still = distance(ROWS.state, ROWS.next_state) < 0.001
    moved = (steps.next_state - steps.state)[:, :3]
    assert np.abs(moved[still]).max() < 0.03
    speed = np.linalg.norm(steps.action[:, :3], axis=1)
    heading = (moved * steps.action[:, :3]).sum(axis=1)[still & (speed > 0.9)]
    assert (heading > 0).mean() > 0.95


def test_an_inserted_peg_is_also_tried_deeper_in_the_hole():
    steps, _, _ = corrected_steps()
    depth = (ROWS.state - steps.state)[:, 4]
    inside = ROWS.state[:, 4] < -0.2
    assert depth[inside].max() > 0.03
    assert not depth[~inside & ~CARRIED & ~is_around(steps)].any()
    np.testing.assert_allclose((ROWS.next_state - steps.next_state)[inside, 4], depth[inside], atol=1e-6)


def test_a_carried_peg_is_tried_elsewhere_and_led_back_around_the_block():
    steps, _, _ = corrected_steps()
    offset = steps.state - ROWS.state
    moved = np.abs(offset[:, HEAD]).max(axis=1) > 0
    moved &= (ROWS.state[:, 4] > -0.15) & ~is_around(steps)
    assert moved[CARRIED].mean() > 0.6
    assert not moved[~CARRIED].any()
    np.testing.assert_allclose(offset[moved, :3], offset[moved, HEAD], atol=1e-6)
    assert_clear_of_the_block(steps, moved)
    head, action = steps.state[:, HEAD], steps.action
    np.testing.assert_array_equal(action[moved, GRIPPER], ROWS.action[moved, GRIPPER])
    beside = moved & (head[:, 0] < -0.14) & (np.abs(head[:, 1] - 0.6) > 0.12)
    assert beside.sum() > 5
    np.testing.assert_allclose(action[beside, 1], 0.0, atol=1e-6)
    assert (action[beside, 0] > 0).all()
    far = moved & ~beside & (head[:, 0] > -0.08) & (np.linalg.norm(offset[:, :3], axis=1) > 0.1)
    along = -(action[far, :3] * offset[far, :3]).sum(axis=1) / np.linalg.norm(offset[far, :3], axis=1)
    assert (along > 0.8).all()
    against = (offset[:, HEAD] * ROWS.action[:, :3]).sum(axis=1)
    assert (against[moved & (head[:, 0] > -0.12)] < 0.03 + 1e-6).all(), "a peg is not led back against its way"
    change = steps.next_state - steps.state
    assert np.abs(change[moved][:, HEAD]).max() < 0.03


def test_an_approach_to_a_peg_beside_the_block_goes_around_it():
    steps, _, to_clone = corrected_steps()
    around = is_around(steps)
    lying = (distance(ROWS.state, ROWS.next_state) < 0.001) & (ROWS.state[:, 6] < 0.05) & ~CARRIED
    assert 0.1 < around[lying].mean() < 0.4
    assert not around[~lying].any()
    assert to_clone[around].all(), "an approach serves every goal"
    hand, head = steps.state[around, :3], steps.state[around, HEAD]
    action = steps.action[around]
    assert (head[:, 0] < -0.3).all()
    assert (np.abs(head[:, 1] - 0.6) > 0.12).all()
    side = np.sign(head[:, 1] - 0.6)
    clear = side * (hand[:, 1] - 0.6) >= 0.16
    assert 0.1 < clear.mean() < 0.9
    assert (hand[~clear, 0] > -0.18).all(), "a hand that is not beside the block is in front of it"
    assert (action[~clear, 1] * side[~clear] > 0).all(), "it moves to the side on which the peg lies"
    assert (hand[~clear, 0] + 0.01 * action[~clear, 0] > -0.18).all(), "and not against the block"
    ahead = clear & (hand[:, 0] > head[:, 0] + 0.2) & (hand[:, 2] > 0.2)
    assert ahead.any()
    assert (action[ahead, 0] < 0).all(), "then it moves to the peg"
    assert (action[:, GRIPPER] == -1).all()


def test_a_peg_beside_the_block_is_not_moved_and_none_is_moved_behind_it():
    state, following = ROWS.state.copy(), ROWS.next_state.copy()
    state[:, HEAD] = following[:, HEAD] = [-0.3, 0.8, 0.02]
    method, every = make_algo("cfbrl", hindsight=0.0, translated=1.0, corrected=0.0), np.ones(len(state), bool)
    assert not transform(method, ROWS._replace(state=state, next_state=following), every, ~every)[1].any()
    steps = transformed(translated=1.0)[0]
    hand, head = steps.state[:, :3], steps.state[:, HEAD]
    outside = ROWS.state[:, 4] > -0.15
    behind = (head[:, 0] < -0.31) & (np.abs(hand[:, 1] - 0.6) < 0.16) & outside
    assert not behind.any(), "the straight way of the demonstration would lead into the block"


def test_the_dynamics_of_tabletop_are_the_same_after_a_move(env):
    def move(key):
        start_key, action_key, offset_key = jax.random.split(key, 3)
        start = env.reset_uniform(start_key)
        action = jax.random.uniform(action_key, (3,), minval=-1.0)
        state, following = start.obs[:6], env.step(start, action).obs[:6]
        offset = env.translation(offset_key, state, following)
        moved = env.step(env.state_from_demo(state + offset, start.info["goal"]), action).obs[:6]
        return following, offset, moved

    following, offset, moved = jax.device_get(jax.jit(jax.vmap(move))(jax.random.split(KEY, 400)))
    np.testing.assert_allclose(moved, following + offset, atol=1e-5)
    changed, at_wall = (offset != 0).any(axis=1), (np.abs(following[:, :4]) >= 2.8).any(axis=1)
    assert 0.1 < changed.mean() < 0.9
    assert at_wall.any()
    assert not changed[at_wall].any()


def test_a_demonstrated_row_gets_goals_of_its_own_demonstration():
    """The states that follow it in the replay, which `later` has, can belong to another demonstration."""
    method, goals = make_algo("cfbrl", hindsight=1.0, translated=0.0, corrected=0.0), goal_table(PEG)
    end = int(goals.ends[0])
    row = np.resize(np.arange(end), len(ROWS.state))
    assert (goals.ends[:end] == end).all()
    other = goals.candidates[goals.ends[end + 1]]
    later, no = np.broadcast_to(other, (len(row), 7)), np.zeros(len(row), bool)
    batch = make_batch(row, goals.candidates[row], goals.candidates[row + 1], later, no)
    demonstrated = np.asarray(relabel(method, batch._replace(demonstrated=~no)).goal)[:, HEAD]
    own = goals.candidates[: end + 1, HEAD]
    places = np.abs(demonstrated[:, None] - own[None]).max(axis=-1).argmin(axis=1)
    np.testing.assert_allclose(demonstrated, own[places], atol=1e-6)
    assert len(set(places.tolist())) > 20
    lived = np.asarray(relabel(method, batch).goal)[:, HEAD]
    np.testing.assert_allclose(lived, np.broadcast_to(other[HEAD], lived.shape), atol=1e-6)


def test_relabelled_rows_have_the_reward_and_the_end_of_their_new_goal():
    method, goals, size = make_algo("cfbrl", hindsight=0.7, translated=0.7), goal_table(PEG), len(ROWS.state)
    kept = np.arange(size) % 5 == 0
    batch = make_batch(np.arange(size), ROWS.state, ROWS.next_state, ROWS.later, kept)
    batch = batch._replace(demonstrated=np.arange(size) % 2 == 0)
    new = jax.device_get(relabel(method, batch))
    reached = success(np.concatenate([new.next_state, new.goal], axis=-1))
    changed = (new.goal != goals.table[0]).any(axis=1)
    assert (reached & changed).any()
    np.testing.assert_array_equal(new.reward[changed], reached[changed])
    np.testing.assert_array_equal(new.flags.reached[changed], reached[changed])
    np.testing.assert_array_equal(new.state[kept], batch.state[kept])
    assert not changed[kept].any()
    assert not new.demonstrated[1::2].any()
    assert 0 < new.demonstrated.sum() < batch.demonstrated.sum()
    dense = dataclasses.replace(PEG, reward_type="dense")
    assert method.relabel(KEY, dense, goals, batch, jnp.asarray(TASK)) is batch


def test_the_cloning_draws_from_transformed_demonstrations(monkeypatch):
    monkeypatch.setattr(cfbrl, "COPIES", 4)
    method = make_algo("cfbrl", hindsight=0.5, translated=0.5, corrected=0.0)
    plain = demonstrations(make_problem(PEG), method)
    demos = jax.jit(lambda: method.transformed_demos(KEY, PEG))()
    assert demos.obs.shape == (4 * len(plain.obs), 14)
    same = (np.asarray(demos.obs) == np.tile(plain.obs, (4, 1))).all(axis=1)
    assert 0.5 < same.mean() < 0.95
    np.testing.assert_array_equal(demos.action, np.tile(plain.action, (4, 1)))


def test_only_the_critics_learn_in_the_warmup_and_nothing_without_learning():
    rows = np.random.default_rng(0).normal(size=(2, 16, 12)).astype(np.float32)
    no = np.arange(16) < 4
    batch = sac.Batch(rows[0], rows[0, :, :3], rows[0, :, 0], no, rows[1], demonstrated=no, step=np.int32(0))
    first = make_algo("cfbrl", hidden_sizes=[16], batch_size=16, actor_average_rate=0.5)
    agent = jax.jit(lambda key: sac.init(key, first.sac, 12, 3))(KEY)
    update = jax.jit(lambda method: method.update_agent(KEY, agent, batch)[0])
    for warmup, learns in ((4.0, False), (0.0, True)):
        after = update(first.replace(warmup=warmup))
        for name in ("actor", "averaged", "log_temperature"):
            pairs = zip(*(jax.tree.leaves(getattr(state, name)) for state in (agent, after)), strict=True)
            assert any((np.asarray(old) != np.asarray(new)).any() for old, new in pairs) == learns, name
        assert (jax.tree.leaves(after.critics)[-1] != jax.tree.leaves(agent.critics)[-1]).any()
    assert make_algo("cfbrl", learning=False).update_agent(KEY, agent, batch)[0] is agent


def test_a_phase_explores_after_its_patience_with_actions_that_are_held(problem):
    horizon = problem.env.eval_horizon
    method = make_algo("cfbrl", patience=0.5, exploration=0.25)
    explores = jax.jit(jax.vmap(lambda key, step: method.explores(key, problem.env, TASK, step, ()), in_axes=(0, None)))
    keys = jax.random.split(KEY, 2000)
    assert not explores(keys, horizon // 2 - 1).any()
    assert 0.2 < explores(keys, horizon // 2).mean() < 0.3

    always, start, end = lived("cfbrl")
    first = int(start.replay.row)
    actions = np.asarray(end.replay.action[first : first + CHUNK, 0])
    blocks = actions.reshape(CHUNK // always.explore_hold, always.explore_hold, -1)
    np.testing.assert_array_equal(blocks, np.broadcast_to(blocks[:, :1], blocks.shape))
    assert (blocks[0] != blocks[1]).any()


@pytest.mark.slow
def test_it_trains_on_a_task_without_translations_and_on_a_dense_one():
    for task in (make("sawyer_door"), make("tabletop_organization", reward_type="dense")):
        result = tiny_train("cfbrl", task, pretrain_steps=2, warmup=0.0)
        assert np.isfinite(result.metrics["critic_loss"]).all()
