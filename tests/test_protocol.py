"""Settings and rules: when the world is touched, who asks for what, and how a run says so."""

import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.algos.learner.replay import unpack
from earl_jax.envs import HelpBudget, make
from earl_jax.protocol import Continuing, Deployment, Protocol, Rules, setting_of, split_setting
from earl_jax.runs.config import RunConfig
from earl_jax.training import init as birth
from earl_jax.training import loop as autonomy
from earl_jax.training import split_options
from earl_jax.training.state import Problem
from tests.conftest import advance, assert_same, newborn, tiny_method


def lived(problem, method, rules, steps, seeds=(0, 1)):
    """The explored lives of lanes with `rules`, each a list of one number a lane."""
    keys = jax.vmap(jax.random.key)(jnp.asarray(seeds))
    capacity = birth.capacity_for(problem, method, steps)
    start = jax.jit(lambda m, k, r: birth.begin(problem, m, k, capacity, r))(method, keys, rules)
    return advance(problem, method, start, steps, explore=True)


def rules(horizon, chance=(0.0, 0.0), goal_change=(0, 0)):
    return Rules(jnp.array(horizon), jnp.array(chance, jnp.float32), jnp.array(goal_change))


def test_a_protocol_refuses_nonsense():
    with pytest.raises(ValueError, match="eval_every must be at least 1, not 0"):
        Protocol(10, 10, eval_every=0)
    with pytest.raises(ValueError, match=r"train_horizon must be at least 1, or 0 for never, not -1"):
        Protocol(-1, 10)
    with pytest.raises(ValueError, match=r"intervention_chance must lie in \[0, 1\), not 1"):
        Protocol(10, 10, intervention_chance=1)


def test_interventions_follow_the_horizon_and_the_chance():
    steps, keys = jnp.arange(1, 4001), jax.random.split(jax.random.key(0), 4000)
    due = jax.vmap(Protocol(5, 5).rules.intervened)(steps, keys)
    np.testing.assert_array_equal(due, np.arange(1, 4001) % 5 == 0)
    assert not jax.vmap(Protocol(0, 5).rules.intervened)(steps, keys).any()
    rate = jax.vmap(Protocol(0, 5, intervention_chance=0.1).rules.intervened)(steps, keys).mean()
    assert float(rate) == pytest.approx(0.1, abs=0.015)


def test_lanes_of_one_program_live_by_rules_of_their_own(problem):
    method = tiny_method("naive")
    lives = lived(problem, method, rules([0, 20], (0.1, 0.0)), 200)
    chance, every = np.asarray(lives.lanes.counters.interventions)
    assert every == 10
    assert 8 <= chance <= 34
    alone = lived(problem, tiny_method("naive", 1), rules([20], [0.0], [0]), 200, seeds=[1])
    assert_same(jax.tree.map(lambda leaf: leaf[1:], lives.lanes.world), alone.lanes.world)


@pytest.mark.parametrize("algo", ["naive", "fbrl"])
def test_in_the_continuing_setting_the_world_asks(env, problem, monkeypatch, algo):
    """Goals change on the clock alone; a task attempt follows at once, a way back goes on to its end."""
    monkeypatch.setattr(
        autonomy, "_act", lambda problem, method, lane, key, explore: problem.env.expert(lane.world.obs)
    )
    method, seen = tiny_method(algo), []
    lives = newborn(problem, method, [0, 1], 400)
    lives = lives.replace(lanes=lives.lanes.replace(rules=rules([0, 0], goal_change=(100, 100))))
    for _ in range(16):
        lives = advance(problem, method, lives, 25, explore=True)
        commands, phase = lives.lanes.commands, np.asarray(lives.lanes.phase)
        seen.append(np.asarray(commands.task))
        assert (np.asarray(commands.goal) == commands.task)[phase == 0].all()
        assert (np.asarray(commands.goal) >= len(env.goal_states))[phase == 1].all()
    tasks = np.concatenate([np.asarray(seen)[3:-1].reshape(3, 4, 2), np.asarray(seen)[None, -1:].repeat(4, 1)])
    assert (tasks == tasks[:, :1]).all(), "a task changes every 100 steps and at no other time"
    assert len(np.unique(tasks)) > 1
    earned = float(lives.lanes.counters.window_reward.sum())
    assert (earned > 400) if algo == "naive" else (8 < earned < 40)


def test_settings_say_which_numbers_of_a_task_hold():
    door = make("sawyer_door", physics="c")
    assert Deployment().protocol(door) == Protocol(200_000, 300)
    assert Continuing().protocol(door) == Protocol(50_000, 300, goal_change=600)
    assert Continuing().protocol(dataclasses.replace(door, train_horizon=700)).train_horizon == 700
    assert Continuing(goal_change=30, intervention_chance=0.01).protocol(make("tabletop_organization")) == Protocol(
        50_000, 200, intervention_chance=0.01, goal_change=30
    )
    with pytest.raises(ValueError, match="unknown setting 'lifelong'; choose from deployment, continuing"):
        setting_of("lifelong")
    with pytest.raises(ValueError, match="setting 'deployment' has no option 'goal_change'"):
        setting_of("deployment", goal_change=3)


def test_a_budget_makes_a_world_with_help_and_back(env):
    world = Deployment(budget=5.0, help_cost=2.0, help_above=0.5).world(env)
    assert world == HelpBudget(env, budget=5.0, help_cost=2.0, help_above=0.5)
    assert split_setting(world, Continuing()) == (env, Continuing(budget=5.0, help_cost=2.0, help_above=0.5))
    assert Continuing().protocol(world) == Protocol(50_000, 200, goal_change=400)
    assert Deployment().world(env) is env


def test_an_experiment_remembers_its_setting(env):
    method = tiny_method("naive")
    one = RunConfig.of(HelpBudget(env, budget=5.0), method, (0, 1), 40, 40, 1, 40, Continuing(goal_change=7))
    assert one.setting == {"name": "continuing", "budget": 5.0, "goal_change": 7}
    again = RunConfig(**json.loads(json.dumps(dataclasses.asdict(one))))
    assert again.build_env() == HelpBudget(env, budget=5.0)
    assert again.build_setting() == Continuing(goal_change=7, budget=5.0)
    assert again.protocol(again.build_env()).goal_change == 7


def test_a_map_counts_every_step(problem):
    lives = advance(problem, tiny_method("fbrl"), newborn(problem, tiny_method("fbrl"), [0, 1]), 40, explore=True)
    visits = np.asarray(lives.lanes.visits)
    assert visits.sum(axis=(1, 2)).tolist() == [40, 40]
    low, high = problem.env.map_bounds
    last = np.floor((np.asarray(lives.replay.state[int(lives.replay.row), :, :2]) - low) / (high - low) * 64).astype(
        int
    )
    assert all(visits[lane, x, y] > 0 for lane, (x, y) in enumerate(last))
    cheetah = Problem(make("cheetah_run", physics="c"), problem.protocol)
    assert newborn(cheetah, tiny_method("naive"), [0, 1]).lanes.visits is None


def test_the_step_into_the_end_is_worth_the_end_for_ever(problem):
    world = Deployment(budget=1.0, help_above=-1.0, absorbed_reward=-2.0).world(
        make("tabletop_organization", reward_type="dense")
    )
    method = tiny_method("naive", discount=[0.9, 0.5])
    lives = newborn(Problem(world, problem.protocol), method, [0, 1])
    first = int(lives.replay.row)
    lives = advance(Problem(world, problem.protocol), method, lives, 3, explore=True)
    np.testing.assert_allclose(lives.replay.reward[first], [-20.0, -4.0], rtol=1e-5)
    assert np.asarray(unpack(lives.replay.flags[first]).absorbed).all()
    listed = np.asarray(lives.replay.counts[:, 0] - lives.replay.demos[0])
    assert listed.tolist() == [1, 1]
    assert np.asarray(lives.lanes.counters.window_reward).tolist() == [-6.0, -6.0]


def test_options_find_task_setting_and_method():
    options = {"setting": "continuing", "goal_change": 5, "budget": 3, "wide": True, "reward_scale": 1.0}
    world, setting, rest = split_options("tabletop_organization", options)
    assert setting == Continuing(goal_change=5, budget=3)
    assert world == setting.world(make("tabletop_organization", wide=True))
    assert rest == {"reward_scale": 1.0}
    with pytest.raises(
        ValueError, match="goal_change is an option of the setting 'continuing', and this is 'deployment'"
    ):
        split_options("tabletop_organization", {"goal_change": 5})
