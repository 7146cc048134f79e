"""Options of the learner beyond EARL's: ensembles, several critic updates a step, and the cloning term."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.algos import make_algo
from earl_jax.algos.learner import sac as sac_lib
from earl_jax.algos.learner.cloning import cloning_term, cloning_weight
from earl_jax.algos.learner.networks import TanhNormal
from earl_jax.algos.learner.sac import SAC, Batch

SMALL = SAC(hidden_sizes=(16,), batch_size=8, reward_scale=2.0, initial_temperature=0.3)
ROWS, SIZE = 8, 2
init = jax.jit(sac_lib.init, static_argnames=("obs_size", "action_size", "critics"))
td_targets = jax.jit(jax.vmap(sac_lib.td_target, (None, None, None, 0)))
q_values = jax.jit(sac_lib.q_values)
act_with_log_prob = jax.jit(sac_lib.act_with_log_prob, static_argnums=4)


@pytest.fixture(scope="module")
def batch():
    rng, rows = np.random.default_rng(0), np.arange(ROWS)
    obs, next_obs = rng.normal(size=(2, ROWS, 4)).astype(np.float32)
    action, reward = rng.uniform(-1, 1, (ROWS, SIZE)).astype(np.float32), rng.normal(size=ROWS).astype(np.float32)
    return Batch(obs, action, reward, rows == 0, next_obs, demonstrated=rows % 4 == 1, step=np.int32(0))


@pytest.mark.parametrize(("subset", "entropy", "critics"), [(2, True, 2), (1, False, 4), (5, True, 2)])
def test_the_target_of_an_ensemble_is_the_minimum_of_one_random_subset(batch, subset, entropy, critics):
    sac = SMALL.replace(ensemble=5, target_subset=subset, backup_entropy=entropy)
    agent, keys = init(jax.random.key(1), sac, 4, SIZE, critics=critics), jax.random.split(jax.random.key(2), 12)
    targets, used = np.asarray(td_targets(sac, agent, batch, keys)), set()
    for key, target in zip(keys, targets, strict=True):
        action, log_prob = act_with_log_prob(sac, agent.actor, batch.next_obs, key, SIZE)
        q = np.asarray(q_values(sac, agent.targets, batch.next_obs, action))
        live = ~np.asarray(batch.terminal)
        expected = {
            pair: 2.0 * batch.reward + live * 0.99 * (q[list(pair)].min(axis=0) - entropy * 0.3 * log_prob)
            for pair in itertools.combinations(range(5), subset)
        }
        matches = [pair for pair, values in expected.items() if np.allclose(target[:5], values, rtol=1e-4, atol=1e-5)]
        assert len(matches) == 1
        used.add(matches[0])
        free = [2.0 * batch.reward + live * 0.99 * q[5:].min(axis=0)] * 2 if critics > 2 else np.zeros((0, ROWS))
        np.testing.assert_allclose(target[5:], free, rtol=1e-4)
    assert len(used) > 2 or subset == 5


@pytest.mark.parametrize(("ensemble", "lowest"), [(2, True), (4, False)])
def test_the_actor_climbs_the_minimum_of_two_and_the_mean_of_more(batch, ensemble, lowest):
    sac = SMALL.replace(ensemble=ensemble)
    agent, key = init(jax.random.key(1), sac, 4, SIZE, critics=4), jax.random.key(3)
    after, _ = jax.jit(lambda a: sac_lib._update_actor(sac, a, batch, key, None))(agent)

    @jax.jit
    @jax.grad
    def expected(actor):
        action, log_prob = sac_lib.act_with_log_prob(sac, actor, batch.obs, key, SIZE)
        q = sac_lib.q_values(sac, agent.critics, batch.obs, action)[:ensemble]
        return (0.3 * log_prob - (q.min(axis=0) if lowest else q.mean(axis=0))).mean()

    assert_first_gradient(after, expected(agent.actor))


def assert_first_gradient(agent, grads):
    """Check the gradient of the actor's first step: Adam's first moment is a tenth of it."""
    for moment, grad in zip(jax.tree.leaves(agent.moments["actor"].mu), jax.tree.leaves(grads), strict=True):
        np.testing.assert_allclose(10 * np.asarray(moment), grad, rtol=1e-3, atol=1e-5)


def test_utd_updates_the_critics_on_each_batch_and_the_actor_once(batch):
    sac, agent = SMALL.replace(utd=4), init(jax.random.key(1), SMALL, 4, SIZE)
    whole = jax.tree.map(lambda leaf: np.concatenate([leaf] * 4), batch._replace(step=None))
    whole = whole._replace(
        reward=np.arange(4, dtype=np.float32).repeat(ROWS), terminal=np.ones(4 * ROWS, bool), step=batch.step
    )
    after, _ = jax.jit(lambda a, b: sac_lib.update(sac, a, b, jax.random.key(4)))(agent, whole)
    counts = {name: int(moments.count) for name, moments in after.moments.items()}
    assert counts == {"critics": 4, "actor": 1, "temperature": 1}

    @jax.jit
    def update_critics(agent, number):
        part = batch._replace(reward=jnp.full(ROWS, number), terminal=np.ones(ROWS, bool))
        agent, _ = sac_lib._update_critics(sac, agent, part, jax.random.key(0))  # terminal: no action is drawn
        slow = jax.tree.map(lambda s, f: s + 0.005 * (f - s), agent.targets, agent.critics)
        return agent.replace(targets=slow)

    by_hand = agent
    for number in range(4):
        by_hand = update_critics(by_hand, float(number))
    for field in ("critics", "targets"):
        for actual, expected in zip(*[jax.tree.leaves(getattr(a, field)) for a in (after, by_hand)], strict=True):
            np.testing.assert_allclose(actual, expected, atol=1e-6)


def test_the_averaged_actor_follows_the_actor_is_deployed_and_changes_no_learning(batch):
    update, key = jax.jit(sac_lib.update), jax.random.key(4)
    averaging = SMALL.replace(actor_average_rate=0.25)
    first, plain = init(jax.random.key(1), averaging, 4, SIZE), init(jax.random.key(1), SMALL, 4, SIZE)
    agent = first.replace(averaged=jax.tree.map(lambda leaf: leaf + 1.0, first.actor))
    after, without = update(averaging, agent, batch, key)[0], update(SMALL, plain, batch, key)[0]
    for slow, old, new in zip(*map(jax.tree.leaves, (after.averaged, agent.averaged, after.actor)), strict=True):
        np.testing.assert_allclose(slow, 0.75 * old + 0.25 * new, atol=1e-6)
    assert after.deployed_actor is after.averaged
    other = after.with_actor(agent.actor)
    assert other.actor is other.averaged is agent.actor
    assert without.averaged is None
    assert without.deployed_actor is without.actor
    for beside, alone in zip(*map(jax.tree.leaves, (after.actor, without.actor)), strict=True):
        np.testing.assert_allclose(beside, alone, rtol=1e-6)


def test_the_gradient_of_the_cloning_term_is_the_analytic_one(batch):
    sac = SMALL.replace(cloning=0.5)
    parameters = jax.random.normal(jax.random.key(5), (ROWS, 2 * SIZE))
    grads = np.asarray(jax.jit(jax.grad(lambda p: cloning_term(sac, p, batch)))(parameters))
    mode, action = np.tanh(np.asarray(parameters)[:, :SIZE]), np.asarray(batch.action)
    expected = 0.5 * 2.0 * 2 * (mode - action) * (1 - mode**2) / (2 * SIZE)  # two demonstrated rows
    demonstrated = np.asarray(batch.demonstrated)
    np.testing.assert_allclose(grads[demonstrated, :SIZE], expected[demonstrated], rtol=1e-4)
    assert not grads[~demonstrated].any()
    assert not grads[:, SIZE:].any()
    none = batch._replace(demonstrated=np.zeros(ROWS, bool))
    assert float(cloning_term(sac, parameters, none)) == 0.0
    assert cloning_term(SMALL, parameters, batch) is None


def test_the_actor_s_gradient_has_the_cloning_term_added(batch):
    method = make_algo("naive", hidden_sizes=[16], reward_scale=2.0, cloning=3.0)
    sac, agent = method.sac, init(jax.random.key(1), SMALL, 4, SIZE)
    step = jax.jit(lambda a, term: sac_lib._update_actor(sac, a, batch, jax.random.key(3), term)[0], static_argnums=1)
    plain, cloned = step(agent, None), step(agent, method.actor_term)

    @jax.jit
    @jax.grad
    def term(actor):
        mode = TanhNormal(SIZE).mode(sac_lib._policy(sac, actor, batch.obs, SIZE))
        errors = jnp.square(mode - batch.action)[batch.demonstrated]
        return 3.0 * 2.0 * errors.mean()

    both = jax.tree.map(lambda moment, grad: 10 * moment + grad, plain.moments["actor"].mu, term(agent.actor))
    assert_first_gradient(cloned, both)


def test_the_weight_of_the_cloning_term_follows_its_schedule():
    sac = SMALL.replace(cloning=1.0, cloning_final=0.1, cloning_start=100, cloning_steps=200)
    weights = [float(cloning_weight(sac, jnp.asarray(step))) for step in (0, 100, 200, 300, 10_000)]
    np.testing.assert_allclose(weights, [1.0, 1.0, 0.55, 0.1, 0.1], rtol=1e-5)
    held = SMALL.replace(cloning=0.4, cloning_steps=200)
    assert float(cloning_weight(held, jnp.asarray(10_000))) == pytest.approx(0.4)


def test_a_subset_larger_than_the_ensemble_is_an_error():
    with pytest.raises(ValueError, match="target_subset 3 is larger than the ensemble of 2 critics"):
        make_algo("naive", target_subset=3)
    assert make_algo("naive", ensemble=3, target_subset=3).sac.ensemble == 3


def test_the_weights_of_cloning_can_differ_between_lanes():
    method = make_algo("fbrl", cloning=[0.0, 1.0])
    np.testing.assert_array_equal(method.sac.cloning, [0.0, 1.0])
    with pytest.raises(ValueError, match="cloning must lie in"):
        make_algo("fbrl", cloning=-1.0)
