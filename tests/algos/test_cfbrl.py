"""CFBRL: hindsight goals, moved transitions, what of them is cloned, the warm-up, and exploration of stuck phases."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.algos import make_algo
from earl_jax.algos.cfbrl import COPIES, Steps
from earl_jax.algos.goals import goal_table
from earl_jax.algos.learner.replay import TransitionBatch, TransitionFlags
from earl_jax.algos.method import TASK
from earl_jax.envs import make
from earl_jax.envs.sawyer.experts import peg_grasp
from earl_jax.training.demo_rows import demonstrations
from tests.conftest import (
    advance,
    assert_equal_trees,
    make_problem,
    make_train_state,
    run_whole,
    tiny_method,
    tiny_train,
)

KEY = jax.random.key(3)
PEG = make("sawyer_peg")
HEAD, GRIPPER = slice(4, 7), 3


@pytest.fixture(scope="module")
def rows():
    """Return the demonstrated forward steps of the peg, whose later states are 20 steps ahead or the last one."""
    demos = PEG.demos("forward")
    last = np.flatnonzero(demos.ends)
    end = last[np.searchsorted(last, np.arange(len(demos.ends)))]
    later = demos.next_states[np.minimum(np.arange(len(end)) + 20, end)]
    return Steps(*map(jnp.asarray, (demos.states, demos.actions, demos.next_states, later, demos.goals)))


def transformed(rows, allowed=True, demonstrated=False, **shares):
    method = make_algo("cfbrl", **{"hindsight": 0.0, "translated": 0.0, "corrected": 0.0, **shares})
    every = jnp.ones(len(rows.state), bool)
    transform = jax.jit(lambda steps: method.transform(KEY, PEG, steps, every & allowed, every & demonstrated))
    return transform(rows)


def assert_clear_of_the_block(steps, moved):
    """Assert that heads keep 2.5 cm and hands 6 cm from the block's sides, where they are not in front of it."""
    states = np.concatenate([steps.state, steps.next_state])[np.tile(moved, 2)]
    for points, margin in ((states[:, HEAD], 0.025), (states[:, :3], 0.06)):
        assert not ((points[:, 0] < -0.17 - 0.01) & (np.abs(points[:, 1] - 0.6) < 0.1 + margin - 0.01)).any()


def make_batch(row, state, next_state, later, no_successor):
    """Return transitions with the first goal, no action and no reward."""
    size = len(row)
    no = jnp.zeros(size, bool)
    flags = TransitionFlags(jnp.zeros(size, int), no, no, no_successor, no)
    action, reward = jnp.zeros((size, 4)), jnp.zeros(size)
    return TransitionBatch(jnp.asarray(row), state, action, next_state, reward, flags, later=later)


def is_carried(rows):
    """Return the steps, bool [B], in which the hand holds the peg outside of the hole."""
    state, action = np.asarray(rows.state), np.asarray(rows.action)
    held = (state[:, GRIPPER] < 0.5) & (action[:, 3] > 0) & (np.asarray(rows.next_state)[:, 4] > -0.15)
    return held & (np.linalg.norm(state[:, :3] - np.asarray(jax.vmap(peg_grasp)(state[:, HEAD])), axis=1) < 0.03)


def is_around(rows, steps):
    """Return which approaches, bool [B], a correction has moved to a peg beside the block."""
    head, before = np.asarray(steps.state)[:, HEAD], np.asarray(rows.state)[:, HEAD]
    return (head[:, :2] != before[:, :2]).any(axis=1) & ~is_carried(rows) & (before[:, 0] > -0.2)


def distance(first, second):
    return np.linalg.norm(np.asarray(first)[:, HEAD] - np.asarray(second)[:, HEAD], axis=1)


def test_without_shares_and_where_it_is_not_allowed_nothing_changes(rows):
    for steps, changed, to_clone in (transformed(rows), transformed(rows, False, hindsight=1.0, translated=1.0)):
        assert not changed.any()
        assert to_clone.all()
        for new, old in zip(steps[:3], rows[:3], strict=True):
            np.testing.assert_array_equal(new, old)
        np.testing.assert_array_equal(steps.goal, rows.goal)


def test_a_hindsight_goal_is_the_object_of_a_later_state(rows):
    steps, changed, to_clone = transformed(rows, hindsight=1.0)
    assert changed.all()
    np.testing.assert_allclose(distance(steps.goal, rows.later), 0.0, atol=1e-7)
    np.testing.assert_array_equal(steps.goal[:, :4], np.broadcast_to(PEG.goal_states[0, :4], (len(steps.goal), 4)))
    ahead = distance(rows.state, rows.later) > 0.05
    assert 0.1 < ahead.mean() < 0.9
    np.testing.assert_array_equal(to_clone, ahead)


def test_a_move_shifts_hand_and_object_alike_and_stays_clear_of_the_block(rows):
    steps, changed, to_clone = transformed(rows, translated=1.0)
    offset = np.asarray(steps.state - rows.state)
    np.testing.assert_allclose(offset[:, :2], offset[:, 4:6], atol=1e-6)
    np.testing.assert_allclose(steps.next_state - rows.next_state, offset, atol=1e-6)
    np.testing.assert_array_equal(np.delete(offset, [0, 1, 4, 5], axis=1), 0.0)
    np.testing.assert_array_equal(changed, (offset != 0).any(axis=1))
    assert 0.2 < changed.mean() < 0.9
    assert_clear_of_the_block(steps, np.asarray(changed))
    inserted = np.asarray(rows.next_state)[:, 4] < -0.2
    assert inserted.any()
    assert not changed[inserted].any(), "the block takes part in an insertion"
    np.testing.assert_array_equal(to_clone, ~changed)


def test_a_corrected_step_leads_back_to_the_demonstrated_one(rows):
    steps, changed, to_clone = transformed(rows, demonstrated=True, corrected=1.0)
    still = (distance(rows.state, rows.next_state) < 0.001) & ~is_carried(rows) & ~is_around(rows, steps)
    assert changed.all()
    lying = (np.asarray(rows.state)[:, 4] > -0.2) & (
        np.asarray(steps.state)[:, HEAD] == np.asarray(rows.state)[:, HEAD]
    ).all(1)
    assert lying[still].all()
    for new, old in zip(steps, rows, strict=True):
        np.testing.assert_array_equal(new[lying & ~still], old[lying & ~still])
    back = np.asarray(rows.state - steps.state)[:, :3]
    far = (np.linalg.norm(back, axis=1) > 0.1) & lying
    assert 0.2 < far[still].mean() < 0.9
    action = np.asarray(steps.action)
    along = (action[far, :3] * back[far]).sum(axis=1) / np.linalg.norm(back[far], axis=1)
    assert (along > 0.8).all()
    assert np.abs(action).max() <= 1.0
    closed = np.asarray(steps.state)[:, GRIPPER] < np.asarray(rows.state)[:, GRIPPER]
    assert closed[far].any()
    assert (action[closed, GRIPPER] < 0).all(), "a hand that is closed far from the peg opens"
    goals = {tuple(goal) for goal in np.asarray(steps.goal)[still].round(4)}
    assert len(goals) > 2, "an approach serves every goal"
    at_goal = np.asarray(PEG.success(jnp.concatenate([steps.state, steps.goal], axis=-1)))
    np.testing.assert_array_equal(to_clone[still], ~at_goal[still])


def test_the_next_state_of_a_corrected_step_is_near_the_simulated_one(rows):
    steps, _, _ = transformed(rows, demonstrated=True, corrected=1.0)
    still = distance(rows.state, rows.next_state) < 0.001
    moved = np.asarray(steps.next_state - steps.state)[:, :3]
    assert np.abs(moved[still]).max() < 0.03
    speed = np.linalg.norm(np.asarray(steps.action)[:, :3], axis=1)
    heading = (moved * np.asarray(steps.action)[:, :3]).sum(axis=1)[still & (speed > 0.9)]
    assert (heading > 0).mean() > 0.95


def test_an_inserted_peg_is_also_tried_deeper_in_the_hole(rows):
    steps, _, _ = transformed(rows, demonstrated=True, corrected=1.0)
    depth = np.asarray(rows.state - steps.state)[:, 4]
    inside = np.asarray(rows.state)[:, 4] < -0.2
    assert depth[inside].max() > 0.03
    assert not depth[~inside & ~is_carried(rows) & ~is_around(rows, steps)].any()
    np.testing.assert_allclose(np.asarray(rows.next_state - steps.next_state)[inside, 4], depth[inside], atol=1e-6)


def test_a_carried_peg_is_tried_elsewhere_and_led_back_around_the_block(rows):
    steps, _, _ = transformed(rows, demonstrated=True, corrected=1.0)
    offset = np.asarray(steps.state - rows.state)
    moved = np.abs(offset[:, HEAD]).max(axis=1) > 0
    moved &= (np.asarray(rows.state)[:, 4] > -0.15) & ~is_around(rows, steps)
    assert moved[is_carried(rows)].mean() > 0.6
    assert not moved[~is_carried(rows)].any()
    np.testing.assert_allclose(offset[moved, :3], offset[moved, HEAD], atol=1e-6)
    assert_clear_of_the_block(steps, moved)
    head, action = np.asarray(steps.state)[:, HEAD], np.asarray(steps.action)
    np.testing.assert_array_equal(action[moved, GRIPPER], np.asarray(rows.action)[moved, GRIPPER])
    beside = moved & (head[:, 0] < -0.14) & (np.abs(head[:, 1] - 0.6) > 0.12)
    assert beside.sum() > 5
    np.testing.assert_allclose(action[beside, 1], 0.0, atol=1e-6)
    assert (action[beside, 0] > 0).all()
    far = moved & ~beside & (head[:, 0] > -0.08) & (np.linalg.norm(offset[:, :3], axis=1) > 0.1)
    along = -(action[far, :3] * offset[far, :3]).sum(axis=1) / np.linalg.norm(offset[far, :3], axis=1)
    assert (along > 0.8).all()
    against = (offset[:, HEAD] * np.asarray(rows.action)[:, :3]).sum(axis=1)
    assert (against[moved & (head[:, 0] > -0.12)] < 0.03 + 1e-6).all(), "a peg is not led back against its way"
    change = np.asarray(steps.next_state - steps.state)
    assert np.abs(change[moved][:, HEAD]).max() < 0.03


def test_an_approach_to_a_peg_beside_the_block_goes_around_it(rows):
    steps, _, to_clone = transformed(rows, demonstrated=True, corrected=1.0)
    around = is_around(rows, steps)
    lying = (distance(rows.state, rows.next_state) < 0.001) & (np.asarray(rows.state)[:, 6] < 0.05) & ~is_carried(rows)
    assert 0.1 < around[lying].mean() < 0.4
    assert not around[~lying].any()
    assert to_clone[around].all(), "an approach serves every goal"
    hand, head = np.asarray(steps.state)[around, :3], np.asarray(steps.state)[around, HEAD]
    action = np.asarray(steps.action)[around]
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


def test_a_peg_beside_the_block_is_not_moved_and_none_is_moved_behind_it(rows):
    beside = rows._replace(
        state=rows.state.at[:, HEAD].set(jnp.array([-0.3, 0.8, 0.02])),
        next_state=rows.next_state.at[:, HEAD].set(jnp.array([-0.3, 0.8, 0.02])),
    )
    assert not transformed(beside, translated=1.0)[1].any()
    steps = transformed(rows, translated=1.0)[0]
    hand, head = np.asarray(steps.state)[:, :3], np.asarray(steps.state)[:, HEAD]
    outside = np.asarray(rows.state)[:, 4] > -0.15
    behind = (head[:, 0] < -0.31) & (np.abs(hand[:, 1] - 0.6) < 0.16) & outside
    assert not behind.any(), "the straight way of the demonstration would lead into the block"


def test_without_learning_the_agent_stays_as_cloned(problem):
    method = tiny_method("cfbrl", pretrain_steps=0, learning=False, warmup=0.0)
    start = make_train_state(problem, method, [0, 1])
    end = advance(problem, method, start, 4)
    assert_equal_trees(end.lanes.agent, start.lanes.agent)


def test_the_dynamics_of_tabletop_are_the_same_after_a_move(env):
    keys = jax.random.split(KEY, 400)
    starts = jax.jit(jax.vmap(env.reset_uniform))(keys)
    actions = jax.random.uniform(KEY, (400, 3), minval=-1.0)
    step = jax.jit(jax.vmap(env.step))
    states, following = starts.obs[:, :6], step(starts, actions).obs[:, :6]
    offset = jax.jit(jax.vmap(env.translation))(keys, states, following)
    moved = jax.jit(jax.vmap(env.state_from_demo))(states + offset, starts.info["goal"])
    np.testing.assert_allclose(step(moved, actions).obs[:, :6], following + offset, atol=1e-5)
    assert 0.1 < (offset != 0).any(axis=1).mean() < 0.9
    at_wall = (jnp.abs(following[:, :4]) >= 2.8).any(axis=1)
    assert at_wall.any()
    assert not (offset[at_wall] != 0).any()


def test_a_demonstrated_row_gets_goals_of_its_own_demonstration():
    """The states that follow it in the replay, which `later` has, can belong to another demonstration."""
    method, goals = make_algo("cfbrl", hindsight=1.0, translated=0.0, corrected=0.0), goal_table(PEG)
    end = int(goals.ends[0])
    row = np.repeat(np.arange(end), 20)
    assert (goals.ends[:end] == end).all()
    other = jnp.asarray(goals.candidates)[goals.ends[end + 1]]
    no = jnp.zeros(len(row), bool)
    later = jnp.broadcast_to(other, (len(row), 7))
    batch = make_batch(row, jnp.asarray(goals.candidates[row]), jnp.asarray(goals.candidates[row + 1]), later, no)
    relabel = jax.jit(lambda batch: method.relabel(KEY, PEG, goals, batch, TASK))
    demonstrated = np.asarray(relabel(batch._replace(demonstrated=~no)).goal)[:, HEAD]
    own = np.asarray(goals.candidates)[: end + 1, HEAD]
    places = np.abs(demonstrated[:, None] - own[None]).max(axis=-1).argmin(axis=1)
    np.testing.assert_allclose(demonstrated, own[places], atol=1e-6)
    assert len(set(places.tolist())) > 20
    lived = np.asarray(relabel(batch._replace(demonstrated=no)).goal)[:, HEAD]
    np.testing.assert_allclose(lived, np.broadcast_to(other[HEAD], lived.shape), atol=1e-6)


def test_relabelled_rows_have_the_reward_and_the_end_of_their_new_goal(rows):
    method, goals = make_algo("cfbrl", hindsight=0.7, translated=0.7), goal_table(PEG)
    size = len(rows.state)
    no_successor = jnp.arange(size) % 5 == 0
    batch = make_batch(jnp.arange(size), rows.state, rows.next_state, rows.later, no_successor)
    batch = batch._replace(demonstrated=jnp.arange(size) % 2 == 0)
    new = jax.jit(lambda batch: method.relabel(KEY, PEG, goals, batch, jnp.asarray(TASK)))(batch)
    reached = PEG.success(jnp.concatenate([new.next_state, new.goal], axis=-1))
    changed = (new.goal != jnp.asarray(goals.table)[0]).any(axis=1)
    assert (reached & changed).any()
    np.testing.assert_array_equal(new.reward[changed], reached[changed])
    np.testing.assert_array_equal(new.flags.reached[changed], reached[changed])
    kept = np.arange(size) % 5 == 0
    np.testing.assert_array_equal(new.state[kept], batch.state[kept])
    assert not changed[kept].any()
    assert not new.demonstrated[1::2].any()
    assert 0 < new.demonstrated.sum() < batch.demonstrated.sum()
    dense = dataclasses.replace(PEG, reward_type="dense")
    assert method.relabel(KEY, dense, goals, batch, jnp.asarray(TASK)) is batch


def test_the_cloning_draws_from_transformed_demonstrations():
    method = make_algo("cfbrl", hindsight=0.5, translated=0.5, corrected=0.0)
    plain = demonstrations(make_problem(PEG), method)
    demos = jax.jit(lambda: method.transformed_demos(KEY, PEG))()
    assert demos.obs.shape == (COPIES * len(plain.obs), 14)
    same = (np.asarray(demos.obs) == np.tile(plain.obs, (COPIES, 1))).all(axis=1)
    assert 0.5 < same.mean() < 0.95
    np.testing.assert_array_equal(demos.action, np.tile(plain.action, (COPIES, 1)))


def test_only_the_critics_learn_in_the_warmup(problem):
    method = tiny_method("cfbrl", pretrain_steps=0, warmup=[4.0, 0.0], hindsight=0.0, actor_average_rate=0.5)
    start = make_train_state(problem, method, [0, 1])
    end = advance(problem, method, start, 4)
    for lane, learns in ((0, False), (1, True)):
        for name in ("actor", "averaged"):
            actors = [jax.tree.leaves(getattr(s.lanes.agent, name)) for s in (start, end)]
            assert any((old[lane] != new[lane]).any() for old, new in zip(*actors, strict=True)) == learns
        temperatures = [s.lanes.agent.log_temperature[lane, 0] for s in (start, end)]
        assert (temperatures[0] != temperatures[1]) == learns
        critics = [jax.tree.leaves(s.lanes.agent.critics)[-1][lane] for s in (start, end)]
        assert (critics[0] != critics[1]).any()


def test_a_phase_explores_after_its_patience_with_actions_that_are_held(problem):
    horizon = problem.env.eval_horizon
    method = make_algo("cfbrl", patience=0.5, exploration=0.25)
    explores = jax.jit(jax.vmap(lambda key, step: method.explores(key, problem.env, TASK, step, ()), in_axes=(0, None)))
    keys = jax.random.split(KEY, 2000)
    assert not explores(keys, horizon // 2 - 1).any()
    assert 0.2 < explores(keys, horizon // 2).mean() < 0.3

    always = tiny_method("cfbrl", pretrain_steps=0, patience=0.0, exploration=1.0)
    end = run_whole(problem, always, make_train_state(problem, always, [0, 1]), 3 * always.explore_hold)
    first = int(end.replay.first_row)
    actions = np.asarray(end.replay.action[first : first + 3 * always.explore_hold, 0])
    blocks = actions.reshape(3, always.explore_hold, -1)
    np.testing.assert_array_equal(blocks, np.broadcast_to(blocks[:, :1], blocks.shape))
    assert (blocks[0] != blocks[1]).any()


@pytest.mark.slow
def test_it_trains_on_a_task_without_translations_and_on_a_dense_one():
    for task in (make("sawyer_door"), make("tabletop_organization", reward_type="dense")):
        result = tiny_train("cfbrl", task, pretrain_steps=2, warmup=0.0)
        assert np.isfinite(result.metrics["critic_loss"]).all()
