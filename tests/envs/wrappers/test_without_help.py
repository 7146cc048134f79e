"""Evaluation without help, on the chain: nothing is charged, enforced or restarted."""

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.adapters._session import Session
from earl_jax.envs import HelpBudget, plain_task
from earl_jax.envs.wrappers.without_help import without_help
from earl_jax.protocol import Deployment
from tests.envs.chain import Chain

RIGHT, HELP = jnp.array([[1.0, -1.0], [1.0, 1.0]])


def test_the_plain_task_is_the_one_inside_the_budget():
    chain = Chain()
    assert plain_task(HelpBudget(chain, 2.0)) is chain
    assert plain_task(chain) is without_help(chain) is chain


def test_without_help_an_agent_falls_once_and_its_requests_move_like_other_actions():
    helped = HelpBudget(Chain(start=1), budget=2.0)
    env = without_help(helped)
    assert (env.obs_size, env.action_size) == (helped.obs_size, helped.action_size)
    state = env.with_goal(env.reset(jax.random.key(0)), jnp.array([3.0]))
    positions = []
    for action in (HELP, RIGHT, HELP, RIGHT):
        state = env.step(state, action)
        positions.append(float(state.obs[0]))
        assert (float(state.obs[1]), float(state.done), int(state.info["asked"] + state.info["enforced"])) == (1, 0, 0)
    assert positions == [2, 3, 4, 4]


def test_without_help_a_fault_stays_a_fault():
    env = without_help(HelpBudget(Chain(fragile=True), budget=2.0))
    state = env.step(env.reset(jax.random.key(0)), jnp.array([-1.0, -1.0]))
    assert env.fault(state)


def test_episodes_of_the_adapters_have_the_spaces_of_the_lifetime_and_no_help():
    setting = Deployment(budget=1.0)
    train, episodes = (Session.of(Chain(start=1), mode=mode, setting=setting) for mode in ("train", "eval"))
    assert (episodes.env.obs_size, episodes.env.action_size) == (train.env.obs_size, train.env.action_size)
    state = episodes.start(np.uint32(0))
    state, result = episodes.step(state, HELP)
    assert (float(result.obs[0]), float(result.obs[1]), bool(result.terminated)) == (2, 1, False)
    assert bool(train.step(train.start(np.uint32(0)), HELP)[1].terminated)
    assert train.protocol == episodes.protocol
