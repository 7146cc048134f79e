"""The learner against closed forms: targets, densities and precisions."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from earl_jax.algos import make_algo
from earl_jax.algos.learner.cloning import cloning_term, cloning_weight
from earl_jax.algos.learner.networks import MLP, apply, mode, tanh_log_prob
from earl_jax.algos.learner.sac import SAC
from tests.algos.learner.conftest import ROWS, SIZE
from tests.conftest import assert_equal_trees

SMALL = SAC(hidden_sizes=(32, 32), batch_size=64, reward_scale=1.0)


# Each is one program; called eagerly, every operation would be one.
init = jax.jit(SAC.init, static_argnames=("obs_size", "action_size", "entropy_free_pairs"))
q_values = jax.jit(SAC.q_values)
act = jax.jit(SAC.act)
value = jax.jit(SAC.value)


def test_tanh_normal_has_the_paper_s_density():
    parameters = jnp.array([0.3, -0.8, -0.5, 5.0])
    raw = jnp.array([0.1, -0.4])
    std = np.exp([-0.5, 2.0])
    density = stats.norm.logpdf([0.1, -0.4], [0.3, -0.8], std) - np.log(1 - np.tanh([0.1, -0.4]) ** 2)
    np.testing.assert_allclose(tanh_log_prob(parameters, raw), density.sum(), rtol=1e-5)
    np.testing.assert_allclose(mode(parameters), np.tanh([0.3, -0.8]), rtol=1e-5)


def test_networks_start_glorot_uniform_with_zero_biases():
    params = jax.jit(MLP((256, 256, 3)).init)(jax.random.key(0), jnp.zeros(12))["params"]
    kernel = np.asarray(params["hidden_0"]["kernel"])
    bound = np.sqrt(6 / (12 + 256))
    assert 0.98 * bound < np.abs(kernel).max() <= bound
    assert all(not layer["bias"].any() for layer in params.values())
    assert jax.tree.map(np.shape, params)["hidden_2"]["kernel"] == (256, 3)


def relative_errors(actual, exact):
    """Return the relative distance of every leaf from `exact`."""
    return [
        np.linalg.norm(np.subtract(a, b)) / np.linalg.norm(b)
        for a, b in zip(jax.tree.leaves(actual), jax.tree.leaves(exact), strict=True)
    ]


def test_an_update_in_bf16_differs_from_float32_only_by_rounding(batch):
    agent, after = init(SMALL, jax.random.key(0), 4, 2, entropy_free_pairs=1), []
    for precision in ("bf16", "float32"):
        update = jax.jit(SMALL.replace(precision=precision).update)
        after.append(update(jax.random.key(1), agent, batch)[0])
    for network in ("critics", "actor"):
        coarse, exact = (state.moments[network].mu for state in after)
        assert 0 < max(relative_errors(coarse, exact)) < 0.15
    assert {leaf.dtype for leaf in jax.tree.leaves(after[0])} <= {jnp.dtype("float32"), jnp.dtype("int32")}


def test_float32_requests_full_float32_forward_and_backward_and_tf32_does_not(batch):
    agent, texts = init(SMALL, jax.random.key(0), 4, 2), {}
    for precision in ("float32", "tf32"):
        update = jax.jit(SMALL.replace(precision=precision).update)
        texts[precision] = update.lower(jax.random.key(1), agent, batch).as_text()
    products = [line for line in texts["float32"].splitlines() if "dot_general" in line]
    assert len(products) > 15
    assert all("HIGHEST" in line for line in products)
    assert "HIGHEST" not in texts["tf32"]


@pytest.mark.parametrize(
    ("hidden_sizes", "outputs", "layer_norm"),
    [((), 5, False), ((16,), 1, False), ((24, 24, 24), 5, False), ((32, 16), 5, True)],
)
def test_bf16_networks_have_the_gradients_of_float32(hidden_sizes, outputs, layer_norm):
    """Biases keep every unit far from the kink of its ReLU, so that the two differ by rounding alone."""
    network = MLP((*hidden_sizes, outputs), layer_norm)
    keys = jax.random.split(jax.random.key(0), 2)
    blank = jax.jit(network.init)(keys[0], jnp.zeros(7))
    params = jax.tree.map(lambda leaf: 4.0 * (-1.0) ** np.arange(len(leaf)) if leaf.ndim == 1 else leaf, blank)
    x = 0.3 * jax.random.normal(keys[1], (3, 40, 7))

    def outputs_and_gradients(precision):
        out, pull = jax.vjp(lambda p, x: apply(p, x, precision), params, x)
        return out, *pull(1 + 0.5 * jnp.cos(jnp.arange(out.size, dtype=jnp.float32)).reshape(out.shape))

    exact, coarse = [jax.jit(outputs_and_gradients, static_argnums=0)(precision) for precision in ("float32", "bf16")]
    assert max(relative_errors(coarse, exact)) < 0.02
    assert {leaf.dtype for leaf in jax.tree.leaves(coarse)} == {jnp.dtype("float32")}
    single = jax.jit(lambda: apply(params, x[0, 0], "bf16"))()
    np.testing.assert_allclose(single, coarse[0][0, 0], rtol=1e-5, atol=1e-5)
    assert apply(params, x[:, :0], "bf16").shape == (3, 0, outputs)


def test_a_temperature_falls_where_there_is_more_entropy_than_asked_and_a_fixed_one_stays():
    agent = init(SMALL, jax.random.key(0), 4, 2)
    for fixed, expected, gradient in ((True, 0.0, 0.0), (False, -3e-4, 3.0 + 0.5 * 2)):
        after = SMALL.replace(fixed_temperature=fixed).update_temperature(agent, jnp.float32(-3.0), 2)
        assert float(after.log_temperature) == pytest.approx(expected, rel=1e-3)
        assert float(10 * after.moments["temperature"].mu) == pytest.approx(gradient)


SHALLOW = SAC(hidden_sizes=(16,), batch_size=8, reward_scale=2.0, initial_temperature=0.3)
"""A learner for its options beyond EARL's: ensembles, several critic updates a step, and the cloning term."""
td_targets = jax.jit(jax.vmap(SAC.td_target, (None, 0, None, None)))
act_with_log_prob = jax.jit(SAC.act_with_log_prob)


def test_an_update_is_a_step_of_the_critics_then_of_the_actor_on_them_then_of_the_temperature_and_targets(batch):
    """The large step size tells the updated critics from the former ones."""
    sac, key = SHALLOW.replace(learning_rate=0.1), jax.random.key(4)
    agent = init(SHALLOW, jax.random.key(1), 4, SIZE)
    after, diagnostics = jax.jit(SAC.update)(sac, key, agent, batch)
    critic_key, actor_key = jax.random.split(key)
    first, loss = jax.jit(SAC.update_critics)(sac, critic_key, agent, batch)
    second, log_prob = jax.jit(SAC.update_actor)(sac, actor_key, first, batch)
    third = sac.update_temperature(second, log_prob, SIZE)
    targets = jax.tree.map(lambda old, new: old + 0.005 * (new - old), agent.targets, first.critics)
    assert_equal_trees(after, third.replace(targets=targets), rtol=1e-4, atol=1e-5)
    expected = {"critic_loss": loss, "entropy": -log_prob, "temperature": jnp.exp(third.log_temperature)}
    assert_equal_trees(diagnostics, expected, rtol=1e-4)


def test_the_gradient_of_the_actor_divides_by_no_number_of_smallest_values(batch):
    """That number is 0, and the gradient nan, where XLA computes the values twice with other rounding."""
    agent = init(SHALLOW, jax.random.key(1), 4, SIZE)
    assert "reduce_min" not in str(jax.make_jaxpr(SHALLOW.update_actor)(jax.random.key(0), agent, batch))


def test_a_subclass_can_add_a_diagnostic(batch):
    class Watched(SAC):
        name = "watched"
        diagnostics = (*SAC.diagnostics, "mean")

        def update(self, key, agent, batch):
            agent, diagnostics = super().update(key, agent, batch)
            return agent, {**diagnostics, "mean": batch.reward.mean()}

    agent = jax.eval_shape(lambda: SMALL.init(jax.random.key(0), 4, SIZE))
    names = []
    jax.eval_shape(lambda *given: names.extend(Watched().update(*given)[1]), jax.random.key(1), agent, batch)
    assert names == list(Watched.diagnostics)


def test_a_value_is_the_smallest_of_the_critics_without_an_entropy_term(batch):
    agent, key = init(SHALLOW, jax.random.key(1), 4, SIZE, entropy_free_pairs=1), jax.random.key(2)
    values = np.asarray(q_values(SHALLOW, agent.critics, batch.obs, act(SHALLOW, key, agent.actor, batch.obs)))
    np.testing.assert_allclose(value(SHALLOW, key, agent, batch.obs), values[2:].min(axis=0), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(
    ("ensemble", "subset", "entropy", "pairs"), [(2, 2, True, 1), (5, 2, True, 0), (5, 1, False, 1), (5, 5, True, 0)]
)
def test_the_target_of_an_ensemble_is_the_minimum_of_one_random_subset(batch, ensemble, subset, entropy, pairs):
    sac = SHALLOW.replace(ensemble=ensemble, target_subset=subset, backup_entropy=entropy)
    agent = init(sac, jax.random.key(1), 4, SIZE, entropy_free_pairs=pairs)
    keys = jax.random.split(jax.random.key(2), 12)
    targets, used = np.asarray(td_targets(sac, keys, agent, batch)), set()
    for key, target in zip(keys, targets, strict=True):
        action, log_prob = act_with_log_prob(sac, key, agent.actor, batch.next_obs)
        q = np.asarray(q_values(sac, agent.targets, batch.next_obs, action))
        live = ~np.asarray(batch.terminal)
        expected = {
            pair: 2.0 * batch.reward + live * 0.99 * (q[list(pair)].min(axis=0) - entropy * 0.3 * log_prob)
            for pair in itertools.combinations(range(ensemble), subset)
        }
        [match] = [pair for pair, own in expected.items() if np.allclose(target[:ensemble], own, rtol=1e-4, atol=1e-5)]
        used.add(match)
        free = [2.0 * batch.reward + live * 0.99 * q[ensemble:].min(axis=0)] * 2 if pairs else np.zeros((0, ROWS))
        np.testing.assert_allclose(target[ensemble:], free, rtol=1e-4)
    assert len(used) > 2 or subset == ensemble


@pytest.mark.parametrize(("ensemble", "lowest", "cloning"), [(2, True, 0.0), (4, False, 0.0), (2, True, 3.0)])
def test_the_actor_climbs_the_minimum_of_two_or_the_mean_of_more_and_clones(batch, ensemble, lowest, cloning):
    method = make_algo("naive", hidden_sizes=[16], reward_scale=2.0, cloning=cloning, ensemble=ensemble)
    sac, key = method.learner.replace(initial_temperature=0.3), jax.random.key(3)
    agent = init(sac, jax.random.key(1), 4, SIZE, entropy_free_pairs=1)
    after, log_prob = jax.jit(sac.update_actor)(key, agent, batch)
    np.testing.assert_allclose(log_prob, act_with_log_prob(sac, key, agent.actor, batch.obs)[1].mean(), rtol=1e-5)

    @jax.jit
    @jax.grad
    def expected(actor):
        action, log_prob = sac.act_with_log_prob(key, actor, batch.obs)
        q = sac.q_values(agent.critics, batch.obs, action)[:ensemble]
        errors = jnp.square(sac.greedy(actor, batch.obs) - batch.action)[batch.demonstrated]
        value = q.min(axis=0) if lowest else q.mean(axis=0)
        return (0.3 * log_prob - value).mean() + 2.0 * cloning * errors.mean()

    grads = expected(agent.actor)
    assert_equal_trees(jax.tree.map(lambda mean: 10 * mean, after.moments["actor"].mu), grads, rtol=1e-3, atol=1e-5)


def test_utd_updates_the_critics_on_each_batch_and_the_actor_once(batch):
    sac, agent = SHALLOW.replace(utd=4), init(SHALLOW, jax.random.key(1), 4, SIZE)
    whole = jax.tree.map(lambda leaf: np.concatenate([leaf] * 4), batch._replace(step=None))
    whole = whole._replace(
        reward=np.arange(4, dtype=np.float32).repeat(ROWS), terminal=np.ones(4 * ROWS, bool), step=batch.step
    )
    after, diagnostics = jax.jit(sac.update)(jax.random.key(4), agent, whole)
    assert 0 < float(diagnostics["entropy"]) < SIZE * np.log(2), "less than a uniform action has"
    counts = {name: int(moments.count) for name, moments in after.moments.items()}
    assert counts == {"critics": 4, "actor": 1, "temperature": 1}

    @jax.jit
    def update_critics(agent, number):
        part = batch._replace(reward=jnp.full(ROWS, number), terminal=np.ones(ROWS, bool))
        agent, _ = sac.update_critics(jax.random.key(0), agent, part)  # terminal: no action is drawn
        slow = jax.tree.map(lambda s, f: s + 0.005 * (f - s), agent.targets, agent.critics)
        return agent.replace(targets=slow)

    by_hand = agent
    for number in range(4):
        by_hand = update_critics(by_hand, float(number))
    assert_equal_trees((after.critics, after.targets), (by_hand.critics, by_hand.targets), atol=1e-6)


def test_the_averaged_actor_follows_the_actor_is_deployed_and_changes_no_learning(batch):
    update, key = jax.jit(SAC.update), jax.random.key(4)
    averaging = SHALLOW.replace(actor_average_rate=0.25)
    first, plain = init(averaging, jax.random.key(1), 4, SIZE), init(SHALLOW, jax.random.key(1), 4, SIZE)
    agent = first.replace(averaged=jax.tree.map(lambda leaf: leaf + 1.0, first.actor))
    after, without = update(averaging, key, agent, batch)[0], update(SHALLOW, key, plain, batch)[0]
    expected = jax.tree.map(lambda old, new: 0.75 * old + 0.25 * new, agent.averaged, after.actor)
    assert_equal_trees(after.averaged, expected, atol=1e-6)
    assert averaging.deployed(after) is after.averaged
    other = averaging.with_actor(after, agent.actor)
    assert other.actor is other.averaged is agent.actor
    assert without.averaged is None
    assert SHALLOW.deployed(without) is without.actor
    assert_equal_trees(after.actor, without.actor, rtol=1e-6)


def test_without_demonstrated_rows_or_a_weight_there_is_no_cloning_term(batch):
    greedy, none = np.ones((ROWS, SIZE), np.float32), batch._replace(demonstrated=np.zeros(ROWS, bool))
    assert float(cloning_term(SHALLOW.replace(cloning=0.5), greedy, none)) == 0.0
    assert float(cloning_term(SHALLOW, greedy, batch)) == 0.0


def test_the_weight_of_the_cloning_term_follows_its_schedule():
    sac = SHALLOW.replace(cloning=1.0, cloning_final=0.1, cloning_start=100, cloning_steps=200)
    weights = [float(cloning_weight(sac, jnp.asarray(step))) for step in (0, 100, 200, 300, 10_000)]
    np.testing.assert_allclose(weights, [1.0, 1.0, 0.55, 0.1, 0.1], rtol=1e-5)
    held = SHALLOW.replace(cloning=0.4, cloning_steps=200)
    assert float(cloning_weight(held, jnp.asarray(10_000))) == pytest.approx(0.4)


def test_unknown_precisions_values_without_their_critics_and_a_subset_larger_than_the_ensemble_are_refused():
    agent = init(SMALL, jax.random.key(0), obs_size=2, action_size=1)
    for refused, message in (
        (lambda: make_algo("naive", precision="fp8"), "unknown precision 'fp8'; choose from float32, tf32, bf16"),
        (lambda: SMALL.replace(precision="fp8"), "unknown precision 'fp8'; choose from float32, tf32, bf16"),
        (lambda: SMALL.value(jax.random.key(0), agent, jnp.zeros(2)), "entropy_free_pairs = 1"),
        (lambda: make_algo("naive", target_subset=3), "target_subset 3 is larger than the ensemble of 2 critics"),
    ):
        with pytest.raises(ValueError, match=message):
            refused()
    assert make_algo("naive", ensemble=3, target_subset=3).learner.ensemble == 3
