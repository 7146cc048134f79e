"""Many lanes in one program are what gymnasium makes of as many single environments."""

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from earl_jax.adapters.gymnasium import LifeEnv, LifeVectorEnv, env_id
from earl_jax.envs.tabletop import COASTERS
from tests.adapters.test_gymnasium import EPISODE, LIFE, STAY, TABLETOP


def assert_equal(one, other):
    """Equal in values, types and names, however nested; None in the same places."""
    if isinstance(one, dict):
        assert one.keys() == other.keys()
        for name in one:
            assert_equal(one[name], other[name])
    elif isinstance(one, np.ndarray) and one.dtype == object:
        for a, b in zip(one, other, strict=True):
            assert_equal(a, b)
    elif one is None:
        assert other is None
    else:
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize(
    ("autoreset", "options"),
    [
        (None, LIFE),
        ("NextStep", EPISODE),
        ("SameStep", EPISODE),
        ("Disabled", EPISODE),
    ],
)
def test_lanes_are_what_gymnasium_makes_of_single_environments(autoreset, options):
    ours = {} if autoreset is None else {"autoreset_mode": autoreset}
    theirs = {"autoreset_mode": autoreset or "Disabled"}
    lanes = gymnasium.make_vec(env_id(TABLETOP), num_envs=3, **options, **ours)
    singles = gymnasium.make_vec(env_id(TABLETOP), 3, vectorization_mode="sync", vector_kwargs=theirs, **options)
    assert isinstance(lanes, LifeVectorEnv)
    assert lanes.metadata["autoreset_mode"] == singles.metadata["autoreset_mode"]
    assert (lanes.observation_space, lanes.action_space) == (singles.observation_space, singles.action_space)
    for one, other in zip(lanes.reset(seed=4), singles.reset(seed=4), strict=True):
        assert_equal(one, other)
    lanes.action_space.seed(0)
    for _ in range(4 if autoreset == "Disabled" else 17):
        actions = lanes.action_space.sample()
        for one, other in zip(lanes.step(actions), singles.step(actions), strict=True):
            assert_equal(one, other)
    some = {"reset_mask": np.array([True, False, True])}
    for one, other in zip(lanes.reset(options=dict(some)), singles.reset(options=dict(some)), strict=True):
        assert_equal(one, other)
    for one, other in zip(lanes.step(actions), singles.step(actions), strict=True):
        assert_equal(one, other)


@pytest.mark.slow
def test_lanes_have_goals_of_their_own():
    lanes = LifeVectorEnv(TABLETOP, 3, **LIFE)
    obs, _ = lanes.reset(seed=0)
    goals = np.tile(obs[:1, :6], (3, 1))
    set_ = lanes.set_goal(goals, np.array([True, False, True]))
    np.testing.assert_array_equal(set_[:, 6:], [goals[0], obs[1, 6:], goals[2]])
    _, rewards, *_ = lanes.step(np.tile(STAY, (3, 1)))
    np.testing.assert_array_equal(rewards, [1.0, 0.0, 1.0])
    assert (lanes.set_goal()[:, None, 8:10] == COASTERS).all(axis=2).any(axis=1).all()


def test_one_lane_of_many_is_not_reset_by_a_life():
    lanes = LifeVectorEnv(TABLETOP, 2)
    assert lanes.metadata["autoreset_mode"] is AutoresetMode.DISABLED
    with pytest.raises(ValueError, match=r"NextStep.*Disabled.*train"):
        LifeVectorEnv(TABLETOP, 2, autoreset_mode="NextStep")


@pytest.mark.slow
def test_pictures_are_of_each_lane(pictures):
    env, lanes = LifeEnv(TABLETOP, **pictures), LifeVectorEnv(TABLETOP, 2, **pictures)
    env.reset(seed=0)
    lanes.reset(seed=0)
    for _ in range(10):
        lanes.step(np.array([[0, 0, -1], [1, 1, -1]], np.float32))
    still, moved = lanes.render()
    assert env.render().shape == still.shape == (48, 64, 3)
    assert (still != moved).any()
    assert LifeEnv(TABLETOP).render() is None
    env.close()
    lanes.close()
