"""The gymnasium adapter: gymnasium's checker, the rules of lifetimes and episodes, and lanes."""

import copy
import dataclasses
import pickle
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env, data_equivalence

from earl_jax.adapters.gymnasium import ResetFreeEnv, ResetFreeVectorEnv, env_id, register_envs
from earl_jax.algos.naive import Naive
from earl_jax.envs import list_envs, make, register_env
from earl_jax.envs.tabletop import COASTERS, TabletopOrganization
from earl_jax.protocol import Continuing, Deployment, Protocol
from tests.envs.chain import Chain

TABLETOP = "tabletop_organization"
LIFETIME = {"train_horizon": 7, "attempt_steps": 3}
EPISODE = {"mode": "eval", "eval_horizon": 5}
PICTURES = {"render_mode": "rgb_array", "width": 64, "height": 48}
STAY = np.array([0.0, 0.0, -1.0], np.float32)
KNOWN = ("minimum value is -infinity", "maximum value is infinity", "persistent compilation cache")
"""Remarks of gymnasium's checker on every observation without bounds, also in MuJoCo's own environments; and jax's on a
program that another worker is writing."""


@dataclasses.dataclass(frozen=True)
class Fragile(TabletopOrganization):
    """A table on whose right half the simulation breaks."""

    name = "my_fragile"

    def fault(self, state):
        return state.data.qpos[0] > 0.5


def check(name, mode, **options):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_env(gymnasium.make(env_id(name), mode=mode, **options).unwrapped, skip_render_check=not options)
    messages = [str(warning.message) for warning in caught]
    return [message for message in messages if not any(known in message for known in KNOWN)]


@pytest.mark.parametrize("mode", ["train", "eval"])
def test_gymnasiums_checker_has_no_remarks(mode):
    assert check(TABLETOP, mode) == []


def test_gymnasiums_checker_has_no_remarks_on_a_task_without_pictures(monkeypatch):
    monkeypatch.setattr("earl_jax.options.registry.ENVS._table", {"chain": Chain})
    monkeypatch.setattr(gymnasium.envs.registration, "registry", {})
    register_envs()
    assert check("chain", "eval", width=64) == []


def test_an_env_that_has_drawn_is_copied_and_pickled(graphics):
    env = ResetFreeEnv(TABLETOP, **EPISODE, **PICTURES)
    env.reset(seed=0)
    picture = env.render()
    for twin in (copy.deepcopy(env), pickle.loads(pickle.dumps(env))):
        assert (twin.render() == picture).all()
        assert (twin.step(STAY)[0] == copy.deepcopy(env).step(STAY)[0]).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", list_envs())
def test_gymnasiums_checker_has_no_remarks_on_any_task(name, graphics):
    assert check(name, "train", **PICTURES) == []


def test_every_task_has_an_id(monkeypatch):
    assert {env_id(name) for name in list_envs()} <= set(gymnasium.registry)
    assert env_id("sawyer_door") == "earl_jax/SawyerDoor-v0"
    monkeypatch.setattr("earl_jax.options.registry.ENVS._table", {})
    monkeypatch.setattr(gymnasium.envs.registration, "registry", dict(gymnasium.registry))
    monkeypatch.setattr(gymnasium, "registry", gymnasium.envs.registration.registry)
    register_env("my_fragile", Fragile)
    register_envs()
    made = gymnasium.make("earl_jax/MyFragile-v0", reward_type="dense")
    assert made.unwrapped.session.env == Fragile(reward_type="dense")


def test_a_lifetime_never_ends_and_has_interventions_on_schedule_and_at_resets_without_a_seed():
    env = ResetFreeEnv(TABLETOP, **LIFETIME)
    obs, info = env.reset(seed=3)
    assert info["interventions"] == 0
    home, pursued = np.split(obs, [6])
    for step in range(1, 16):
        obs, _, terminated, truncated, info = env.step(env.action_space.sample())
        assert (terminated, truncated) == (False, False)
        assert info["interventions"] == step // 7
        assert np.array_equal(obs[:6], home) == (step % 7 == 0)
        np.testing.assert_array_equal(info["goal"], obs[6:])
        assert set(info) == {"goal", "success", "interventions", "next_obs"}
        led, goal = np.split(info["next_obs"], [6])
        np.testing.assert_array_equal(goal, pursued)
        assert np.array_equal(led, obs[:6]) == (step % 7 != 0), "an intervention moves the agent after the step"
        pursued = obs[6:]
    assert env.reset()[1]["interventions"] == 3
    assert env.state.step == 15
    assert env.reset(seed=3)[1]["interventions"] == 0
    assert env.state.step == 0


def test_a_lifetime_has_the_protocol_of_its_setting():
    env = ResetFreeEnv(TABLETOP, setting=Continuing(goal_change=7), train_horizon=50)
    assert env.session.protocol == Protocol(50, 200, goal_change=7)


def test_a_goal_that_is_not_reached_times_out():
    assert ResetFreeEnv(TABLETOP).session.attempt_steps == Naive().episode_length
    env = ResetFreeEnv(TABLETOP, **LIFETIME)
    goals = [env.reset(seed=0)[0][6:], *(env.step(STAY)[0][6:] for _ in range(140))]
    changes = 1 + np.flatnonzero((np.diff(goals, axis=0) != 0).any(axis=1))
    assert set(changes % 7) == {3, 6, 0}  # after three steps, after three more, and at the intervention


def test_a_set_goal_stays_until_the_choice_is_given_back():
    env = ResetFreeEnv(TABLETOP, **LIFETIME)
    obs, _ = env.reset(seed=0)
    here = obs[:6].copy()
    np.testing.assert_array_equal(env.set_goal(here)[6:], here)
    for _ in range(15):
        obs, reward, _, _, info = env.step(STAY)
        assert (reward, info["success"]) == (1.0, True)
        np.testing.assert_array_equal(obs[6:], here)
    assert info["interventions"] == 2
    assert (env.set_goal()[8:10] == COASTERS).all(axis=1).any()
    assert not env.state.goal_is_set, "the environment chooses again"


@pytest.mark.slow
def test_a_spent_budget_ends_the_lifetime_and_a_reset_starts_another():
    env = ResetFreeEnv(TABLETOP, setting=Deployment(budget=2.0))
    env.reset(seed=0)
    assert env.action_space.shape == (4,)
    ends = [env.step(np.array([0, 0, 0, 1.0]))[2] for _ in range(3)]
    assert ends == [False, True, True]
    obs, info = env.reset()
    assert obs[6] == 1.0
    assert info["interventions"] == 0
    assert not env.step(np.zeros(4))[2]


def test_an_episode_is_truncated_at_its_horizon_and_the_next_starts():
    env = ResetFreeEnv(TABLETOP, **EPISODE)
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


def test_episodes_can_begin_at_wide_starts():
    env = ResetFreeEnv(TABLETOP, starts="wide", **EPISODE)
    starts = {tuple(env.reset(seed=seed)[0][:4]) for seed in range(3)}
    assert len(starts) == 3, "the ordinary start is always the same"
    env.set_goal(env.state.env_state.obs[:6])
    info = env.step(STAY)[4]
    assert info["is_success"]
    assert info["is_success_wide"]
    assert "is_success_wide" not in ResetFreeEnv(TABLETOP, **EPISODE).reset(seed=0)[1]


def test_a_fault_truncates_an_episode_and_resets_a_lifetime():
    right = np.array([1.0, 0.0, -1.0])
    episode = ResetFreeEnv(Fragile(reward_type="dense"), mode="eval")
    episode.reset(seed=0)
    steps = [episode.step(right) for _ in range(3)]
    assert [truncated for _, _, _, truncated, _ in steps] == [False, False, True]
    np.testing.assert_array_equal(steps[2][0], steps[1][0])
    lifetime = ResetFreeEnv(Fragile(reward_type="dense"))
    lifetime.reset(seed=0)
    steps = [lifetime.step(right) for _ in range(3)]
    assert [info["interventions"] for *_, info in steps] == [0, 0, 1]
    assert steps[2][0][0] == 0.0
    assert steps[1][1] < 0.0
    assert steps[2][1] == 0.0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"mood": "eval"}, r"no option 'mood'; choose from mode, .*reward_type"),
        ({"goal_change": 9}, r"of the setting, not of task .*: pass setting=earl_jax.Continuing\(goal_change="),
        ({"budget": 9.0}, r"pass setting=earl_jax.Deployment\(budget=\.\.\.\)"),
        *[({"lanes": 3, **more}, "no option 'lanes'") for more in ({}, {"num_envs": 2})],
        ({"mode": "test"}, "unknown mode 'test'; choose from train, eval"),
        ({"attempt_steps": 0}, "attempt_steps must lie in"),
        *[({"attempt_steps": value}, "attempt_steps must be a whole number, not") for value in (None, 1.5, "x", True, [1])],
        *[({"width": value}, "width must") for value in (None, 1.5, -5, 0, 100_000)],
        ({"height": "x"}, "height must be a whole number, not 'x'"),
        ({"setting": None}, "the setting must be a name or an object of Setting, not None"),
        ({"task": [1]}, r"unknown task \[1\]"),
        ({"task": make(TABLETOP), "reward_type": "dense"}, "go with a task's name"),
        ({"render_mode": "human"}, "render_mode 'human'"),
        ({"task": Chain(), "render_mode": "rgb_array"}, "'rgb_array' is not one of the modes of chain: None$"),
        ({"starts": "wide"}, "starts='wide' is for episodes"),
        ({"setting": Deployment(eval_pairs="balanced"), **EPISODE}, "eval_pairs='balanced' is for evaluations of a run"),
        ({"starts": "far", **EPISODE}, "unknown starts 'far'; choose from initial, uniform, wide"),
        ({"num_envs": 0}, "num_envs must lie in"),
        *[({"num_envs": value}, "num_envs must be a whole number, not") for value in (None, 1.5, "2")],
        ({"num_envs": 2, "autoreset_mode": "NextStep"}, "NextStep.*Disabled.*train"),
    ],
)  # fmt: skip
def test_invalid_options_are_refused(options, message):
    make_env = ResetFreeVectorEnv if "num_envs" in options else ResetFreeEnv
    with pytest.raises(ValueError, match=message):
        make_env(**{"task": TABLETOP, **options})


def test_invalid_calls_are_refused():
    actions = [0, np.nan, 0], [1e300, 0, 0], None, "x", ["a", "b", "c"], [0, [1], 2], {}, [1j, 0, 0], [None] * 3
    options = {"goal": 1}, "x", 1, {1: 2}
    env, lanes = ResetFreeEnv(TABLETOP, **LIFETIME), ResetFreeVectorEnv(TABLETOP, 3, **LIFETIME)
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(STAY)
    env.reset(seed=0)
    lanes.reset(seed=0)
    for call, message in [
        *[(lambda given=given: env.reset(options=given), "reset takes no options") for given in options],
        (lambda: env.step(np.zeros(4)), r"action must be finite and of shape \(3,\)"),
        *[(lambda action=action: env.step(action), "action must be finite") for action in actions],
        (lambda: env.set_goal(np.zeros(2)), r"goal must be finite and of shape \(6,\)"),
        (lambda: lanes.step(STAY), r"actions must be finite and of shape \(3, 3\)"),
        (lambda: lanes.reset(options={"reset_mask": np.array([1, 0, 1])}), r"bool \[3\]"),
        *[(lambda given=given: lanes.reset(options=given), "reset_mask only") for given in options],
        *[(lambda seed=seed: lanes.reset(seed=seed), "one for each of 3 lanes") for seed in ([], [1, 2], "x")],
    ]:
        with pytest.raises(ValueError, match=message):
            call()


@pytest.mark.parametrize(
    ("autoreset", "options"), [(None, LIFETIME), ("NextStep", EPISODE), ("SameStep", EPISODE), ("Disabled", EPISODE)]
)
def test_lanes_equal_single_environments(autoreset, options):
    """A lifetime has no automatic reset."""
    ours = {} if autoreset is None else {"autoreset_mode": autoreset}
    theirs = {"autoreset_mode": autoreset or "Disabled"}
    lanes = gymnasium.make_vec(env_id(TABLETOP), num_envs=3, **options, **ours)
    singles = gymnasium.make_vec(env_id(TABLETOP), 3, vectorization_mode="sync", vector_kwargs=theirs, **options)
    assert isinstance(lanes, ResetFreeVectorEnv)
    assert lanes.metadata["autoreset_mode"] == singles.metadata["autoreset_mode"]
    assert (lanes.observation_space, lanes.action_space) == (singles.observation_space, singles.action_space)
    assert data_equivalence(lanes.reset(seed=4), singles.reset(seed=4), exact=True)
    lanes.action_space.seed(0)
    for _ in range(4 if autoreset == "Disabled" else 17):
        actions = lanes.action_space.sample()
        assert data_equivalence(lanes.step(actions), singles.step(actions), exact=True)
    seeds = [7, None, 2]
    assert data_equivalence(lanes.reset(seed=seeds), singles.reset(seed=seeds), exact=True)
    assert data_equivalence(lanes.step(actions), singles.step(actions), exact=True)
    some = {"reset_mask": np.array([True, False, True])}
    assert data_equivalence(lanes.reset(options=dict(some)), singles.reset(options=dict(some)), exact=True)
    assert data_equivalence(lanes.step(actions), singles.step(actions), exact=True)


@pytest.mark.slow
def test_lanes_have_goals_of_their_own():
    lanes = ResetFreeVectorEnv(TABLETOP, 3, **LIFETIME)
    obs, _ = lanes.reset(seed=0)
    goals = np.tile(obs[:1, :6], (3, 1))
    set_ = lanes.set_goal(goals, np.array([True, False, True]))
    np.testing.assert_array_equal(set_[:, 6:], [goals[0], obs[1, 6:], goals[2]])
    _, rewards, *_ = lanes.step(np.tile(STAY, (3, 1)))
    np.testing.assert_array_equal(rewards, [1.0, 0.0, 1.0])
    assert (lanes.set_goal()[:, None, 8:10] == COASTERS).all(axis=2).any(axis=1).all()


@pytest.mark.slow
def test_render_returns_a_picture_of_each_lane(graphics):
    env, lanes = ResetFreeEnv(TABLETOP, **PICTURES), ResetFreeVectorEnv(TABLETOP, 2, **PICTURES)
    env.reset(seed=0)
    lanes.reset(seed=0)
    for _ in range(10):
        lanes.step(np.array([[0, 0, -1], [1, 1, -1]], np.float32))
    still, moved = lanes.render()
    assert env.render().shape == still.shape == (48, 64, 3)
    assert (still != moved).any()
    assert ResetFreeEnv(TABLETOP).render() is None
    env.close()
    lanes.close()
