"""CFBRL: hindsight goals, moved transitions, what of them is cloned, the warm-up, and exploration of stuck phases."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.algos import cfbrl, make_algo
from earl_jax.algos.cfbrl import Steps
from earl_jax.algos.goals import goal_table
from earl_jax.algos.learner import sac
from earl_jax.algos.method import TASK
from earl_jax.envs import make
from earl_jax.training.init import demonstrations
from tests.algos.lives import lived
from tests.algos.transitions import make_batch
from tests.conftest import CHUNK, assert_equal_trees, make_problem

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


def corrections(state, action, change):
    """Return 500 corrections of a step from `state [7]` that moves hand and peg by `change [7]`, as NumPy arrays."""
    state, change = np.float32(state), np.float32(change)
    draw = jax.jit(jax.vmap(lambda key: PEG.correction(key, state, np.float32(action), state + change)))
    return jax.device_get(draw(jax.random.split(KEY, 500)))


def is_clear(points, margin):
    """Return which `points [B, 3]` are in front of the block or keep `margin` [m] from its sides."""
    return (points[:, 0] > -0.18) | (np.abs(points[:, 1] - 0.6) > 0.1 + margin - 0.01)


def distance(first, second):
    return np.linalg.norm(first[:, HEAD] - second[:, HEAD], axis=1)


def test_without_shares_and_where_it_is_not_allowed_nothing_changes():
    for steps, changed, to_clone in (transformed(), transformed(allowed=False, hindsight=1.0, translated=1.0)):
        assert not changed.any()
        assert to_clone.all()
        for new, old in zip(steps[:3], ROWS[:3], strict=True):
            np.testing.assert_array_equal(new, old)
        np.testing.assert_array_equal(steps.goal, ROWS.goal)


def test_a_task_without_translations_and_corrections_keeps_its_steps():
    door, method = make("sawyer_door"), make_algo("cfbrl", hindsight=0.0)
    demos = door.demos("forward")
    steps = Steps(demos.states, demos.actions, demos.next_states, demos.next_states, demos.goals)
    every = np.ones(len(demos.ends), bool)
    new, changed, to_clone = jax.jit(lambda: method.transform(KEY, door, steps, every, every))()
    assert_equal_trees(new, steps)
    assert not changed.any()
    assert to_clone.all()


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
    for part in (steps.state[changed], steps.next_state[changed]):
        assert (is_clear(part[:, HEAD], 0.025) & is_clear(part[:, :3], 0.06)).all()
    inserted = ROWS.next_state[:, 4] < -0.2
    assert inserted.any()
    assert not changed[inserted].any(), "the block takes part in an insertion"
    np.testing.assert_array_equal(to_clone, ~changed)


def test_corrected_approaches_serve_every_goal():
    steps, changed, to_clone = transformed(demonstrated=True, corrected=1.0)
    assert changed.all()
    assert np.abs(steps.action).max() <= 1.0
    approach = (distance(ROWS.state, ROWS.next_state) < 0.001) & (ROWS.state[:, 4] > -0.2)
    assert len({tuple(goal) for goal in steps.goal[approach].round(4)}) > 2
    at_goal = np.asarray(success(np.concatenate([steps.state, steps.goal], axis=-1)))
    np.testing.assert_array_equal(to_clone[approach], ~at_goal[approach])


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
    batch = make_batch(goals.candidates[row], goals.candidates[row + 1], row=row, action_size=4, later=later)
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
    batch = make_batch(ROWS.state, ROWS.next_state, action_size=4, no_successor=kept, later=ROWS.later)
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
