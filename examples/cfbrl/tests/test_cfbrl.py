"""CFBRL: hindsight goals, moved transitions, what of them is cloned, the warm-up, and exploration of stuck phases."""

import dataclasses
import functools
import re
from importlib import metadata
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import earl_jax
from earl_jax.algos.goals import goal_table
from earl_jax.algos.learner.base import Batch
from earl_jax.algos.learner.replay import TransitionBatch, TransitionFlags
from earl_jax.algos.method import TASK, Moment
from earl_jax.cli import main
from earl_jax_cfbrl import CFBRL, cfbrl
from earl_jax_cfbrl.cfbrl import Steps

KEY = jax.random.key(3)
PEG, TABLETOP = earl_jax.make("sawyer_peg"), earl_jax.make("tabletop_organization")
HEAD = slice(4, 7)
PAGE = Path(__file__).parents[1] / "README.md"


def demonstrated_rows():
    """Return the demonstrated forward steps of the peg, whose later states are 20 steps ahead or the last one."""
    demos = PEG.demonstrations.load("forward")
    last = np.flatnonzero(demos.ends)
    end = last[np.searchsorted(last, np.arange(len(demos.ends)))]
    later = demos.next_states[np.minimum(np.arange(len(end)) + 20, end)]
    return Steps(demos.states, demos.actions, demos.next_states, later, demos.goals)


ROWS = demonstrated_rows()
transform = jax.jit(lambda method, *arguments: method.transform(KEY, PEG, *arguments))
success = jax.jit(PEG.success)
prepare = jax.jit(lambda method, batch: method.prepare(KEY, PEG, goal_table(PEG), batch, TASK, ()))


@functools.cache
def transformed(allowed=True, demonstrated=False, **shares):
    """Return the rows as NumPy arrays after the transformations with these shares, which ones changed, and which to clone."""
    method = earl_jax.make_algo("cfbrl", **{"hindsight": 0.0, "translated": 0.0, "corrected": 0.0, **shares})
    flags = [np.full(len(ROWS.state), flag) for flag in (allowed, demonstrated)]
    return jax.device_get(transform(method, ROWS, *flags))


def make_batch(state, next_state, later, row=None, no_successor=False):
    """Return transitions [B] at the first goal, without reward, whose actions are 0; none is demonstrated."""
    size = len(state)
    no, zeros = np.zeros(size, bool), np.zeros(size, np.float32)
    flags = TransitionFlags(np.zeros(size, int), no, no, no | no_successor, no)
    action, row = np.zeros((size, PEG.action_size), np.float32), np.arange(size) if row is None else row
    batch = TransitionBatch(row, np.float32(state), action, np.float32(next_state), zeros, flags, no)
    return batch._replace(later=later)


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
    door, method = earl_jax.make("sawyer_door"), earl_jax.make_algo("cfbrl", hindsight=0.0)
    demos = door.demonstrations.load("forward")
    steps = Steps(demos.states, demos.actions, demos.next_states, demos.next_states, demos.goals)
    every = np.ones(len(demos.ends), bool)
    new, changed, to_clone = jax.jit(lambda: method.transform(KEY, door, steps, every, every))()
    for part, old in zip(new, steps, strict=True):
        np.testing.assert_array_equal(part, old)
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


def test_a_move_adds_the_same_to_both_states_and_is_not_cloned_with_its_old_goal():
    steps, changed, to_clone = transformed(translated=1.0)
    offset = steps.state - ROWS.state
    np.testing.assert_allclose(steps.next_state - ROWS.next_state, offset, atol=1e-6)
    np.testing.assert_array_equal(changed, (offset != 0).any(axis=1))
    assert 0.2 < changed.mean() < 0.9
    np.testing.assert_array_equal(steps.goal, ROWS.goal)
    np.testing.assert_array_equal(to_clone, ~changed)


def test_corrected_approaches_serve_every_goal():
    steps, changed, to_clone = transformed(demonstrated=True, corrected=1.0)
    assert changed.all()
    assert np.abs(steps.action).max() <= 1.0
    approach = (distance(ROWS.state, ROWS.next_state) < 0.001) & (ROWS.state[:, 4] > -0.2)
    assert len({tuple(goal) for goal in steps.goal[approach].round(4)}) > 2
    at_goal = np.asarray(success(np.concatenate([steps.state, steps.goal], axis=-1)))
    np.testing.assert_array_equal(to_clone[approach], ~at_goal[approach])


def test_a_demonstrated_row_gets_goals_of_its_own_demonstration():
    """The states that follow it in the replay, which `later` has, can belong to another demonstration."""
    method, goals = earl_jax.make_algo("cfbrl", hindsight=1.0, translated=0.0, corrected=0.0), goal_table(PEG)
    end = int(goals.ends[0])
    row = np.resize(np.arange(end), len(ROWS.state))
    assert (goals.ends[:end] == end).all()
    other = goals.candidates[goals.ends[end + 1]]
    later, no = np.broadcast_to(other, (len(row), 7)), np.zeros(len(row), bool)
    batch = make_batch(goals.candidates[row], goals.candidates[row + 1], later, row)
    demonstrated = np.asarray(prepare(method, batch._replace(demonstrated=~no)).goal)[:, HEAD]
    own = goals.candidates[: end + 1, HEAD]
    places = np.abs(demonstrated[:, None] - own[None]).max(axis=-1).argmin(axis=1)
    np.testing.assert_allclose(demonstrated, own[places], atol=1e-6)
    assert len(set(places.tolist())) > 20
    lived = np.asarray(prepare(method, batch).goal)[:, HEAD]
    np.testing.assert_allclose(lived, np.broadcast_to(other[HEAD], lived.shape), atol=1e-6)


def test_relabelled_rows_have_the_reward_and_the_end_of_their_new_goal():
    method, goals, size = earl_jax.make_algo("cfbrl", hindsight=0.7, translated=0.7), goal_table(PEG), len(ROWS.state)
    kept = np.arange(size) % 5 == 0
    batch = make_batch(ROWS.state, ROWS.next_state, ROWS.later, no_successor=kept)
    batch = batch._replace(demonstrated=np.arange(size) % 2 == 0)
    new = jax.device_get(prepare(method, batch))
    reached = success(np.concatenate([new.next_state, new.goal], axis=-1))
    changed = (new.goal != goals.table[0]).any(axis=1)
    assert (reached & changed).any()
    np.testing.assert_array_equal(new.reward[changed], reached[changed])
    np.testing.assert_array_equal(new.flags.reached[changed], reached[changed])
    fixed = prepare(method.replace(fixed_phases=True), batch)
    np.testing.assert_array_equal(fixed.reward, new.reward)
    assert not fixed.flags.reached.any()
    np.testing.assert_array_equal(new.state[kept], batch.state[kept])
    assert not changed[kept].any()
    assert not new.demonstrated[1::2].any()
    assert 0 < new.demonstrated.sum() < batch.demonstrated.sum()
    dense = dataclasses.replace(PEG, reward_type="dense")
    assert method.prepare(KEY, dense, goals, batch, jnp.asarray(TASK), ()) is batch


def test_the_cloning_draws_from_transformed_demonstrations(monkeypatch):
    monkeypatch.setattr(cfbrl, "COPIES", 4)
    method = earl_jax.make_algo("cfbrl", hindsight=0.5, translated=0.5, corrected=0.0)
    parts = [PEG.demonstrations.load(direction) for direction in ("forward", "backward")]
    obs = np.concatenate([np.concatenate([part.states, part.goals], axis=1) for part in parts])
    demos = jax.jit(lambda: method.transformed_demos(KEY, PEG))()
    assert demos.obs.shape == (4 * len(obs), 14)
    same = (np.asarray(demos.obs) == np.tile(obs, (4, 1))).all(axis=1)
    assert 0.5 < same.mean() < 0.95
    np.testing.assert_array_equal(demos.action, np.tile(np.concatenate([part.actions for part in parts]), (4, 1)))


def test_only_the_critics_learn_in_the_warmup_and_nothing_without_learning():
    rows = np.random.default_rng(0).normal(size=(2, 16, 12)).astype(np.float32)
    no = np.arange(16) < 4
    batch = Batch(rows[0], rows[0, :, :3], rows[0, :, 0], no, rows[1], demonstrated=no, step=np.int32(0))
    first = earl_jax.make_algo("cfbrl", hidden_sizes=[16], batch_size=16, actor_average_rate=0.5)
    agent = jax.jit(lambda key: first.learner.init(key, 12, 3))(KEY)
    learn = jax.jit(lambda method: method.learn(KEY, TABLETOP, agent, batch, TASK, ())[0])
    for warmup, learns in ((4.0, False), (0.0, True)):
        after = learn(first.replace(warmup=warmup))
        for name in ("actor", "averaged", "log_temperature"):
            pairs = zip(*(jax.tree.leaves(getattr(state, name)) for state in (agent, after)), strict=True)
            assert any((np.asarray(old) != np.asarray(new)).any() for old, new in pairs) == learns, name
        assert (jax.tree.leaves(after.critics)[-1] != jax.tree.leaves(agent.critics)[-1]).any()
    assert earl_jax.make_algo("cfbrl", learning=False).learn(KEY, TABLETOP, agent, batch, TASK, ())[0] is agent
    with pytest.raises(ValueError, match="the learner 'sac' only, not 'td3'"):
        earl_jax.make_algo("cfbrl", learner="td3").learn(KEY, TABLETOP, agent, batch, TASK, ())


def test_a_stuck_phase_explores_with_random_actions_that_are_repeated():
    learner = earl_jax.make_algo("cfbrl", hidden_sizes=[16]).learner
    actor = jax.jit(lambda: learner.init(KEY, 12, 3).actor)()

    @jax.jit
    def is_random(method, step, phase_step, lane_keys):
        def of_lane(lane_key):
            moment = Moment(step, jnp.asarray(TASK), phase_step, lane_key)
            action = method.act(KEY, TABLETOP, actor, jnp.zeros(12), moment, ())
            return action, (action != method.learner.act(KEY, actor, jnp.zeros(12))).any()

        return jax.vmap(of_lane)(lane_keys)

    lanes, horizon = jax.random.split(KEY, 2000), TABLETOP.eval_horizon
    method = earl_jax.make_algo("cfbrl", patience=0.5, exploration=0.25, hidden_sizes=[16])
    assert not is_random(method, 0, horizon // 2 - 1, lanes)[1].any()
    actions, random = is_random(method, 0, horizon // 2, lanes)
    assert 0.2 < random.mean() < 0.3
    np.testing.assert_array_equal(is_random(method, 9, horizon // 2, lanes)[0], actions)
    following = is_random(method, 10, horizon // 2, lanes)
    assert (following[1] != random).any()
    assert (following[0] != actions)[following[1] & random].all()


TINY = {"hidden_sizes": [16], "batch_size": 16, "pretrain_steps": 3, "warmup": 0.0}
STEPS = 40


def test_the_page_has_every_option():
    rows = re.findall(r"^\| `(\w+)` \| (\S+) \|", PAGE.read_text().split("| field of `CFBRL` |")[1], flags=re.MULTILINE)
    options = {field.name: repr(field.default) for field in dataclasses.fields(CFBRL) if field.name != "learner"}
    assert {name: default for name, default in rows if name in options} == options


def test_the_policies_that_ship_load_without_this_package(monkeypatch):
    monkeypatch.setattr(metadata, "entry_points", lambda **group: [])
    assert "cfbrl" not in earl_jax.list_algos()
    for task, methods in earl_jax.list_pretrained().items():
        if "cfbrl" in methods:
            env = earl_jax.make(task)
            assert earl_jax.pretrained(task, "cfbrl")(np.zeros(env.observation_size)).shape == (env.action_size,)


@pytest.mark.slow
def test_it_is_listed_with_its_package_and_trains_by_name(tmp_path, capsys):
    main(["list", "cfbrl"])
    assert "earl-jax-cfbrl 0.1.0" in capsys.readouterr().out
    lengths = {"seeds": 2, "steps": STEPS, "eval_every": STEPS, "eval_episodes": 1, "eval_horizon": 20}
    result = earl_jax.train("tabletop_organization", "cfbrl", out=tmp_path / "run", **lengths, **TINY)
    assert all(np.isfinite(values).all() for values in result.metrics.values())
    assert (result.metrics["critic_loss"][:, -1] > 0).all()
    assert earl_jax.resume(tmp_path / "run", steps=2 * STEPS).metrics["critic_loss"].shape == (2, 2)
