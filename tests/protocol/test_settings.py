"""The two settings: their horizons, goal changes and budgets."""

import dataclasses

import pytest

from earl_jax.envs import HelpBudget, make
from earl_jax.envs.features import ContinuingDefaults
from earl_jax.protocol import Continuing, Deployment, Protocol, setting_of, split_setting, with_explicit_horizon
from tests.envs.chain import Chain


def test_a_setting_combines_its_own_options_with_the_numbers_of_the_task(env):
    door = make("sawyer_door", engine="c")
    assert Deployment().protocol(door) == Protocol(200_000, 300)
    assert Continuing().protocol(door) == Protocol(50_000, 300, goal_change=600)
    assert Continuing().protocol(dataclasses.replace(door, train_horizon=700)).train_horizon == 700
    changed = {"goal_change": 30, "intervention_chance": 0.01, "eval_pairs": "balanced"}
    assert Continuing(**changed).protocol(env) == Protocol(50_000, 200, **changed)
    assert Deployment(eval_pairs="balanced").protocol(env) == Protocol(200_000, 200, eval_pairs="balanced")


def test_the_lifelong_h_t_of_a_task_can_be_never_and_its_goal_changes_every_two_evaluation_horizons():
    class Endless(Chain):
        continuing = ContinuingDefaults(goal_change=8, train_horizon=0)

    assert Continuing().protocol(Endless()).train_horizon == 0
    assert Continuing().protocol(Chain(eval_horizon=7)) == Protocol(Chain.train_horizon, 7, goal_change=14)


def test_an_explicit_h_t_that_equals_the_tasks_default_holds():
    peg = make("sawyer_peg", engine="c")
    assert Continuing().protocol(peg).train_horizon == 50_000
    assert Continuing(train_horizon=100_000).protocol(peg).train_horizon == 100_000
    assert Continuing(train_horizon=0).protocol(HelpBudget(peg, 1.0)).train_horizon == 0
    asked = with_explicit_horizon(Continuing(), peg, {"train_horizon": 100_000})
    assert asked == Continuing(train_horizon=100_000)
    for setting, options in [
        (Continuing(), {}),
        (Continuing(), {"train_horizon": 700}),
        (Continuing(train_horizon=9), {"train_horizon": 100_000}),
        (Deployment(), {"train_horizon": 100_000}),
    ]:
        assert with_explicit_horizon(setting, peg, options) is setting


def test_unknown_settings_options_and_pairs_are_refused(env):
    with pytest.raises(ValueError, match="unknown setting 'lifelong'; choose from deployment, continuing"):
        setting_of("lifelong")
    with pytest.raises(ValueError, match=r"the setting must be a name or .*; did you mean Continuing\(\)\?"):
        setting_of(Continuing)  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match="setting 'deployment' has no option 'goal_change'"):
        setting_of("deployment", goal_change=3)
    with pytest.raises(ValueError, match="unknown eval_pairs 'stratified'; choose from random, balanced"):
        Deployment(eval_pairs="stratified").protocol(env)


def test_a_budget_wraps_the_task_and_is_split_off_again(env):
    wrapped = Deployment(budget=5.0, help_cost=2.0, help_above=0.5).wrap(env)
    assert wrapped == HelpBudget(env, budget=5.0, help_cost=2.0, help_above=0.5)
    assert split_setting(wrapped, Continuing()) == (env, Continuing(budget=5.0, help_cost=2.0, help_above=0.5))
    assert Continuing().protocol(wrapped) == Protocol(50_000, 200, goal_change=400)
    assert Deployment().wrap(env) is env
    assert split_setting(wrapped, Deployment(budget=5.0, help_cost=2.0, help_above=0.5))[0] is env
    with pytest.raises(ValueError, match="the setting has another budget: leave out one of the two"):
        split_setting(wrapped, Deployment(budget=3.0))
    with pytest.raises(ValueError, match=r"tabletop_organization was not wrapped in it: pass setting.wrap\(env\)"):
        Deployment(budget=5.0).protocol(env)
    with pytest.raises(ValueError, match="the task must be an object of Env, not 'sawyer_peg'"):
        Deployment().protocol("sawyer_peg")
