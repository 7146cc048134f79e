"""TD3 against updates by hand."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.algos import make_algo
from earl_jax.algos.learner.td3 import TD3
from earl_jax.runs.config import method_options
from tests.algos.learner.conftest import ROWS, SIZE
from tests.conftest import CHUNK, advance, assert_equal_trees, make_train_state, tiny_method

SMALL = TD3(hidden_sizes=(16,), reward_scale=2.0)
init = jax.jit(TD3.init, static_argnums=(2, 3))
update = jax.jit(TD3.update)


@pytest.fixture(scope="module")
def agent():
    """An agent whose targets differ from its networks."""
    agent, other = (init(SMALL, jax.random.key(seed), 4, SIZE) for seed in (1, 2))
    return agent.replace(target_actor=other.actor, target_critics=other.critics)


def network(params, x):
    """Return the outputs of one hidden layer of ReLUs, by NumPy."""
    first, last = (jax.device_get(params["params"][name]) for name in ("hidden_0", "hidden_1"))
    return np.maximum(x @ first["kernel"] + first["bias"], 0) @ last["kernel"] + last["bias"]


def value(critics, obs, action):
    """Return the values [2, B] of both critics, by NumPy."""
    pair = np.concatenate([obs, action], axis=1)
    return np.stack([network(jax.tree.map(lambda leaf, k=k: leaf[k], critics), pair)[:, 0] for k in (0, 1)])


@pytest.mark.parametrize("noise", [0.2, 3.0])
def test_the_target_is_the_smaller_value_at_a_smoothed_action_of_the_target_policy(agent, batch, noise):
    learner, key = SMALL.replace(target_noise=noise, discount=0.9), jax.random.key(3)
    drawn = np.clip(noise * np.asarray(jax.random.normal(key, (ROWS, SIZE))), -0.5, 0.5)
    action = np.clip(np.tanh(network(agent.target_actor, batch.next_obs)) + drawn, -1, 1)
    lowest = value(agent.target_critics, batch.next_obs, action).min(axis=0)
    expected = 2.0 * batch.reward + ~batch.terminal * 0.9 * lowest
    target = jax.jit(learner.td_target)(key, agent, batch)
    np.testing.assert_allclose(target, expected, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("cloning", [None, 3.0])
def test_the_critics_learn_every_step_and_the_policy_and_all_targets_every_second_one(agent, batch, cloning):
    learner, key = SMALL.replace(cloning=cloning, pretrain_steps=0), jax.random.key(4)
    early, late = (update(learner, key, agent, batch._replace(step=np.int32(step)))[0] for step in (0, 1))
    _, losses = update(learner, key, late, batch._replace(step=np.int32(2)))
    assert losses["actor_loss"] == late.actor_loss != early.actor_loss == 0
    target = jax.jit(learner.td_target)(jax.random.split(key, 1)[0], agent, batch)

    @jax.jit
    def gradients(agent):
        def critic_loss(critics):
            return jnp.square(learner.q_values(critics, batch.obs, batch.action) - target).mean(axis=1).sum()

        def actor_loss(actor, critics):
            action = learner.greedy(actor, batch.obs)
            error = jnp.square(action - batch.action).mean(axis=1)[np.flatnonzero(batch.demonstrated)].mean()
            return -learner.q_values(critics, batch.obs, action)[0].mean() + 2.0 * (cloning or 0.0) * error

        return jax.grad(critic_loss)(agent.critics), jax.grad(actor_loss)(agent.actor, late.critics)

    of_critics, of_actor = gradients(agent)
    for after, moments, grads in ((early, "critic_moments", of_critics), (late, "actor_moments", of_actor)):
        means = jax.tree.map(lambda mean: 10 * mean, getattr(after, moments).mu)
        assert_equal_trees(means, grads, rtol=1e-3, atol=1e-5)
    for field in ("actor", "target_actor", "target_critics"):
        for old, kept, moved in zip(*(jax.tree.leaves(getattr(of, field)) for of in (agent, early, late)), strict=True):
            np.testing.assert_array_equal(old, kept)
            assert (np.asarray(moved) != old).any()
    expected = jax.tree.map(lambda old, new: old + 0.005 * (new - old), agent.target_actor, late.actor)
    assert_equal_trees(late.target_actor, expected, atol=1e-6)


def test_with_utd_the_critics_learn_from_each_batch_and_the_policy_once(agent, batch):
    whole = jax.tree.map(lambda leaf: np.concatenate([leaf] * 3), batch._replace(step=None))._replace(step=np.int32(1))
    after, _ = update(SMALL.replace(utd=3), jax.random.key(4), agent, whole)
    assert (int(after.critic_moments.count), int(after.actor_moments.count)) == (3, 1)


def test_the_life_is_noisy_within_the_bounds_and_the_evaluation_is_not(agent, batch):
    obs = 0.2 * batch.obs  # for actions far from the bounds
    greedy = np.asarray(jax.jit(SMALL.greedy)(agent.actor, obs))
    np.testing.assert_allclose(greedy, np.tanh(network(agent.actor, obs)), rtol=1e-4)
    keys = jax.random.split(jax.random.key(5), 4000)
    acted = jax.jit(jax.vmap(SMALL.act, (0, None, None)))(keys, agent.actor, obs)
    np.testing.assert_allclose((acted - greedy).std(axis=0), 0.1, atol=0.01)
    lowest = value(agent.critics, obs, acted[0]).min(axis=0)
    np.testing.assert_allclose(jax.jit(SMALL.value)(keys[0], agent, obs), lowest, rtol=1e-4, atol=1e-5)
    loud = SMALL.replace(exploration_noise=5.0)
    assert (np.abs(jax.jit(loud.act)(jax.random.key(6), agent.actor, batch.obs)) <= 1).all()


def test_a_method_takes_another_learner_by_name_and_keeps_what_it_presets_for_all():
    method = make_algo("rlpd", learner="td3", policy_delay=3)
    assert isinstance(method.learner, TD3)
    assert (method.learner.demo_share, method.learner.timeout_bootstrap, method.learner.policy_delay) == (0.5, True, 3)
    assert method_options(method) == {"learner": "td3", "policy_delay": 3}
    assert make_algo("rlpd", **method_options(method)) == method
    with pytest.raises(ValueError, match="'naive' has no option 'ensemble' with the learner 'td3': leave it out"):
        make_algo("naive", learner="td3", ensemble=5)
    with pytest.raises(ValueError, match="unknown learner 'ppo'; choose from sac, td3"):
        make_algo("naive", learner="ppo")


def test_td3_learns_in_the_loop_also_where_a_method_reads_its_values(problem):
    method = tiny_method("vaprl", learner="td3")
    end = advance(problem, method, make_train_state(problem, method, [0, 1]), CHUNK)
    assert (end.lanes.counters.diagnostics["critic_loss"] > 0).all()
    assert end.lanes.method_state.values.any()
