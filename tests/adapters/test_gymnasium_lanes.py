"""The vector environment equals gymnasium's vectorisation of as many single environments."""

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import data_equivalence

from earl_jax.adapters.gymnasium import ResetFreeEnv, ResetFreeVectorEnv, env_id
from earl_jax.envs.tabletop import COASTERS
from tests.adapters.test_gymnasium import EPISODE, LIFETIME, PICTURES, STAY, TABLETOP


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
