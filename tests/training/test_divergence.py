"""A lane that diverges is reported and changes no other lane; rewards and actions that are not finite are faults."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax import Method, make, train
from earl_jax.algos import SAC
from earl_jax.envs import list_envs
from earl_jax.envs.tabletop import TabletopOrganization
from tests.conftest import RUN_STEPS, TINY, TINY_RUN, advance, make_problem, make_train_state, tiny_method


class Bonus(Method):
    """Naive RL with a bonus on every reward."""

    bonus: float = 0.0
    name = "bonus"

    def reward(self, env, goals, batch, phase, method_state):
        return batch.reward + self.bonus


@pytest.fixture(scope="module")
def results():
    """Two results of two seeds; in the second one, the bonus of seed 1 is infinite."""
    sac = SAC(**{**TINY, "hidden_sizes": (16,)})
    lanes = [jnp.zeros(2), jnp.array([0.0, jnp.inf])]
    return [train("tabletop_organization", Bonus(sac, bonus=bonus), **TINY_RUN, progress=True) for bonus in lanes]


def test_a_diverged_lane_is_marked_from_its_first_update_on(results):
    assert results[0].metrics["diverged"].tolist() == [[0, 0, 0], [0, 0, 0]]
    assert results[1].metrics["diverged"].tolist() == [[0, 0, 0], [1, 1, 1]]


def test_other_lanes_train_bit_identically(results):
    sound, broken = results
    for name, values in sound.metrics.items():
        np.testing.assert_array_equal(broken.metrics[name][0], values[0], err_msg=name)
    assert np.isfinite(sound.metrics["critic_loss"]).all()


def test_the_actions_of_a_diverged_lane_are_faults(results):
    faults = results[1].metrics["faults"][:, -1]
    assert faults[0] == 0
    assert faults[1] > RUN_STEPS / 2


def test_progress_says_how_many_lanes_have_diverged(capfd):
    sac = SAC(**{**TINY, "hidden_sizes": (16,)})
    train("tabletop_organization", Bonus(sac, bonus=jnp.array([0.0, jnp.inf])), **TINY_RUN, progress=True)
    assert "1 of 2 lanes have diverged" in capfd.readouterr().err


@pytest.mark.parametrize("name", list_envs())
def test_an_action_that_is_not_finite_is_a_fault_on_every_task(name):
    env = make(name) if name == "tabletop_organization" else make(name, engine="c")

    @jax.jit
    def fault_after(state, action):
        return env.fault(env.step(state, action))

    state = env.reset(jax.random.key(0))
    action = jnp.zeros(env.action_size)
    assert not bool(fault_after(state, action))
    assert bool(fault_after(state, action.at[0].set(jnp.nan)))


class BrokenReward(TabletopOrganization):
    name = "broken_reward"

    def reward(self, obs):
        """Return a reward that is not finite in the right half of the table."""
        return jnp.where(obs[..., 0] > 0, jnp.nan, -jnp.abs(obs[..., 0]))


def test_a_reward_that_is_not_finite_is_a_fault_of_its_lane():
    problem = make_problem(BrokenReward(reward_type="dense"), eval_every=40, eval_episodes=2)
    method = tiny_method("naive")
    state = advance(problem, method, make_train_state(problem, method, [0, 1]), 20, explore=True)
    assert (np.asarray(state.lanes.counters.faults) > 0).all()
    assert np.isfinite(state.lanes.counters.window_reward).all()
    assert np.isfinite(state.replay.reward).all()
