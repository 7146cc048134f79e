"""Lives and episodes for gymnasium: its own checker, its own vector environment, and the rules of a life."""

import dataclasses
import subprocess
import sys
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from earl_jax.adapters.gymnasium import LifeEnv, LifeVectorEnv, env_id, register_envs
from earl_jax.algos.naive import BIASED_TD_STEPS
from earl_jax.envs import list_envs, make, register_env
from earl_jax.envs.tabletop import COASTERS, TabletopOrganization
from earl_jax.protocol import Continuing, Deployment

TABLETOP = "tabletop_organization"
LIFE = {"train_horizon": 7, "attempt_steps": 3}
EPISODE = {"mode": "eval", "eval_horizon": 5}
STAY = np.array([0.0, 0.0, -1.0], np.float32)
UNBOUNDED = ("minimum value is -infinity", "maximum value is infinity")
"""What gymnasium's checker says of every observation without bounds, MuJoCo's own environments among them."""


@dataclasses.dataclass(frozen=True)
class Fragile(TabletopOrganization):
    """A table whose right half breaks the simulation."""

    name = "my_fragile"

    def fault(self, state):
        return state.data.qpos[0] > 0.5


def check(name, mode, **options):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_env(gymnasium.make(env_id(name), mode=mode, **options).unwrapped, skip_render_check=not options)
    return [str(one.message) for one in caught if not any(known in str(one.message) for known in UNBOUNDED)]


def until_reached(env, obs):
    """Let the scripted expert act until the goal is reached; return that step."""
    for _ in range(100):
        step = env.step(np.asarray(env.world.env.expert(obs)))
        if step[4]["success"]:
            return step
        obs = step[0]
    raise AssertionError("the expert did not get there")


@pytest.mark.parametrize("mode", ["train", "eval"])
def test_gymnasiums_checker_finds_nothing(mode):
    assert check(TABLETOP, mode) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", list_envs())
def test_gymnasiums_checker_finds_nothing_in_any_task(name, pictures):
    assert check(name, "train", **pictures) == []


@pytest.mark.slow
def test_an_id_with_its_module_needs_no_import():
    code = f"import gymnasium; print(gymnasium.make('earl_jax.adapters.gymnasium:{env_id('sawyer_door')}').reset(seed=0)[0])"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.startswith("[")
    assert "WARN" not in found.stderr


def test_every_task_has_an_id(monkeypatch):
    assert {env_id(name) for name in list_envs()} <= set(gymnasium.registry)
    assert env_id("sawyer_door") == "earl_jax/SawyerDoor-v0"
    monkeypatch.setattr("earl_jax.envs._ENVS._table", {})
    monkeypatch.setattr(gymnasium.envs.registration, "registry", dict(gymnasium.registry))
    monkeypatch.setattr(gymnasium, "registry", gymnasium.envs.registration.registry)
    register_env("my_fragile", Fragile)
    register_envs()
    assert gymnasium.make("earl_jax/MyFragile-v0", reward_type="dense").unwrapped.world.env == Fragile(
        reward_type="dense"
    )


def test_a_life_is_never_over_and_is_touched_on_time():
    env = LifeEnv(TABLETOP, **LIFE)
    obs, info = env.reset(seed=3)
    assert info["interventions"] == 0
    home = obs[:6]
    for step in range(1, 16):
        obs, _, terminated, truncated, info = env.step(env.action_space.sample())
        assert (terminated, truncated) == (False, False)
        assert info["interventions"] == step // 7
        assert np.array_equal(obs[:6], home) == (step % 7 == 0)
        np.testing.assert_array_equal(info["goal"], obs[6:])
        assert set(info) == {"goal", "success", "interventions"}


def test_resets_without_a_seed_are_interventions_and_a_seed_begins_a_life():
    env = LifeEnv(TABLETOP, **LIFE)
    env.reset(seed=3)
    env.step(np.ones(3))
    assert env.reset()[1]["interventions"] == 1
    assert env.life.steps == 1
    assert env.reset(seed=3)[1]["interventions"] == 0
    assert env.life.steps == 0


def test_a_seed_says_what_comes():
    wide = {**EPISODE, "wide": True}
    first, other = LifeEnv(TABLETOP, **wide), LifeEnv(TABLETOP, **wide)
    for seed in (0, 1):
        np.testing.assert_array_equal(first.reset(seed=seed)[0], other.reset(seed=seed)[0])
        np.testing.assert_array_equal(first.reset()[0], other.reset()[0])
    assert not np.array_equal(first.reset(seed=0)[0], first.reset(seed=1)[0])
    unseeded = [LifeEnv(TABLETOP, **wide).reset()[0] for _ in range(2)]
    assert not np.array_equal(*unseeded)


def test_a_reached_goal_gives_way_to_another():
    env = LifeEnv(TABLETOP)
    obs, _ = env.reset(seed=0)
    goals = [obs[6:]]
    for _ in range(6):
        obs, reward, _, _, info = until_reached(env, obs)
        assert reward == 1.0
        assert env.life.attempt == 0
        goals.append(info["goal"])
    assert len(np.unique(goals, axis=0)) > 1
    assert all((goal[2:4] == COASTERS).all(axis=1).any() for goal in goals)


def test_a_goal_that_is_not_reached_gives_way_too():
    assert LifeEnv(TABLETOP).world.attempt_steps == BIASED_TD_STEPS
    env = LifeEnv(TABLETOP, **LIFE)
    goals = [env.reset(seed=0)[0][6:], *(env.step(STAY)[0][6:] for _ in range(140))]
    changes = 1 + np.flatnonzero((np.diff(goals, axis=0) != 0).any(axis=1))
    assert set(changes % 7) == {3, 6, 0}  # after three steps, after three more, and at the intervention


@pytest.mark.slow
def test_the_continuing_settings_goals_go_by_the_clock():
    env = LifeEnv(TABLETOP, setting=Continuing(goal_change=70), train_horizon=50)
    obs, _ = env.reset(seed=1)
    goals = [obs[6:]]
    for _ in range(1400):
        obs = env.step(np.asarray(env.world.env.expert(obs)) if len(goals) < 200 else STAY)[0]
        goals.append(obs[6:])
    changes = 1 + np.flatnonzero((np.diff(goals, axis=0) != 0).any(axis=1))
    assert len(changes) > 5
    assert (changes % 70 == 0).all()
    np.testing.assert_array_equal(env.reset()[0][6:], goals[-1])
    env.set_goal(obs[:6])
    assert (env.reset()[0][8:10] == COASTERS).all(axis=1).any()


def test_a_goal_that_was_set_stays_until_it_is_given_back():
    env = LifeEnv(TABLETOP, **LIFE)
    obs, _ = env.reset(seed=0)
    here = obs[:6].copy()
    np.testing.assert_array_equal(env.set_goal(here)[6:], here)
    for _ in range(15):
        obs, reward, _, _, info = env.step(STAY)
        assert (reward, info["success"]) == (1.0, True)
        np.testing.assert_array_equal(obs[6:], here)
    assert info["interventions"] == 2
    drawn = env.set_goal()
    assert (drawn[8:10] == COASTERS).all(axis=1).any()
    goals = np.array([env.step(STAY)[0][6:] for _ in range(30)])
    assert len(np.unique(goals, axis=0)) > 1


@pytest.mark.slow
def test_a_spent_budget_ends_the_life_and_a_reset_begins_another():
    env = LifeEnv(TABLETOP, setting=Deployment(budget=2.0))
    env.reset(seed=0)
    assert env.action_space.shape == (4,)
    ends = [env.step(np.array([0, 0, 0, 1.0]))[2] for _ in range(3)]
    assert ends == [False, True, True]
    obs, info = env.reset()
    assert obs[6] == 1.0
    assert info["interventions"] == 0
    assert not env.step(np.zeros(4))[2]


def test_an_episode_is_cut_at_its_horizon_and_the_next_begins():
    env = LifeEnv(TABLETOP, **EPISODE)
    obs, _ = env.reset(seed=0)
    goal = obs[6:].copy()
    env.set_goal(obs[:6])
    assert env.step(STAY)[4]["is_success"]
    env.set_goal(goal)
    later = [env.step(STAY) for _ in range(4)]
    ends = [(terminated, truncated) for _, _, terminated, truncated, _ in later]
    assert ends == [(False, False)] * 3 + [(False, True)]
    assert all(np.array_equal(obs[6:], goal) for obs, *_ in later)
    infos = [(info["success"], info["is_success"], info["interventions"]) for *_, info in later]
    assert infos == [(False, True, 0)] * 4
    assert not env.reset()[1]["is_success"]
    assert not env.step(STAY)[3]


def test_a_broken_simulation_cuts_an_episode_and_touches_a_life():
    right = np.array([1.0, 0.0, -1.0])
    episode = LifeEnv(Fragile(reward_type="dense"), mode="eval")
    episode.reset(seed=0)
    steps = [episode.step(right) for _ in range(3)]
    assert [truncated for _, _, _, truncated, _ in steps] == [False, False, True]
    np.testing.assert_array_equal(steps[2][0], steps[1][0])
    life = LifeEnv(Fragile(reward_type="dense"))
    life.reset(seed=0)
    steps = [life.step(right) for _ in range(3)]
    assert [info["interventions"] for *_, info in steps] == [0, 0, 1]
    assert steps[2][0][0] == 0.0
    assert steps[1][1] < 0.0
    assert steps[2][1] == 0.0


def test_mistakes_are_told():
    with pytest.raises(ValueError, match=r"no option 'mood'; choose from mode, .*reward_type"):
        gymnasium.make(env_id(TABLETOP), mood="eval")
    with pytest.raises(ValueError, match="mode 'test' is not one of train, eval"):
        LifeEnv(TABLETOP, mode="test")
    with pytest.raises(ValueError, match="unknown setting 'lifelong'"):
        LifeEnv(TABLETOP, setting="lifelong")
    with pytest.raises(ValueError, match="attempt_steps must be at least 1"):
        LifeEnv(TABLETOP, attempt_steps=0)
    with pytest.raises(ValueError, match="go with a task's name"):
        LifeEnv(make(TABLETOP), reward_type="dense")
    with pytest.raises(ValueError, match="render_mode 'human'"):
        LifeEnv(TABLETOP, render_mode="human")
    with pytest.raises(ValueError, match="num_envs must be at least 1"):
        LifeVectorEnv(TABLETOP, 0)
    env, lanes = LifeEnv(TABLETOP), LifeVectorEnv(TABLETOP, 3)
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(STAY)
    with pytest.raises(ValueError, match="reset takes no options"):
        env.reset(options={"goal": 1})
    env.reset(seed=0)
    lanes.reset(seed=0)
    with pytest.raises(ValueError, match=r"action must be finite and of shape \(3,\)"):
        env.step(np.zeros(4))
    with pytest.raises(ValueError, match=r"action must be finite"):
        env.step(np.array([0.0, np.nan, 0.0]))
    with pytest.raises(ValueError, match=r"goal must be finite and of shape \(6,\)"):
        env.set_goal(np.zeros(2))
    with pytest.raises(ValueError, match=r"actions must be finite and of shape \(3, 3\)"):
        lanes.step(STAY)
    with pytest.raises(ValueError, match=r"bool \[3\]"):
        lanes.reset(options={"reset_mask": np.array([1, 0, 1])})
    with pytest.raises(ValueError, match="no option goal"):
        lanes.reset(options={"goal": 1})
