"""The learner against closed forms: targets, densities, precisions, and a problem of known value."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from earl_jax.algos import make_algo
from earl_jax.algos.learner import sac as sac_lib
from earl_jax.algos.learner.networks import TanhNormal, apply, mlp
from earl_jax.algos.learner.sac import SAC, Batch

SMALL = SAC(hidden_sizes=(32, 32), batch_size=64, reward_scale=1.0)


# Each is one program; called eagerly, every operation would be one.
init = jax.jit(sac_lib.init, static_argnames=("obs_size", "action_size", "critics"))
td_target = jax.jit(sac_lib.td_target)
q_values = jax.jit(sac_lib.q_values)
act_with_log_prob = jax.jit(sac_lib.act_with_log_prob, static_argnums=4)


def make_batch(size=64):
    rng = np.random.default_rng(0)
    obs, next_obs = rng.normal(size=(2, size, 4)).astype(np.float32)
    action, reward = rng.uniform(-1, 1, (size, 2)).astype(np.float32), rng.normal(size=size).astype(np.float32)
    return Batch(obs, action, reward, np.zeros(size, bool), next_obs)


def test_targets_are_the_documented_formula_and_the_scaled_reward_where_terminal():
    sac = SMALL.replace(initial_temperature=0.3, reward_scale=10.0)
    agent, key = init(jax.random.key(0), sac, 4, 2, critics=4), jax.random.key(1)
    batch = make_batch()._replace(terminal=np.arange(64) < 4)
    action, log_prob = act_with_log_prob(sac, agent.actor, batch.next_obs, key, 2)
    q = np.asarray(q_values(sac, agent.targets, batch.next_obs, action))
    soft = 10.0 * batch.reward + 0.99 * (q[:2].min(axis=0) - 0.3 * log_prob)
    plain = 10.0 * batch.reward + 0.99 * q[2:].min(axis=0)
    targets = td_target(sac, agent, batch, key)
    np.testing.assert_allclose(targets[:, 4:], np.stack([soft, soft, plain, plain])[:, 4:], rtol=1e-5)
    np.testing.assert_array_equal(targets[:, :4], np.tile(10.0 * batch.reward[:4], (4, 1)))
    assert (np.abs(targets[:, 4:] - 10.0 * batch.reward[4:]) > 1e-4).all()


def test_tanh_normal_has_the_paper_s_density():
    parameters = jnp.array([0.3, -0.8, -0.5, 5.0])
    raw = jnp.array([0.1, -0.4])
    std = np.exp([-0.5, 2.0])
    density = stats.norm.logpdf([0.1, -0.4], [0.3, -0.8], std) - np.log(1 - np.tanh([0.1, -0.4]) ** 2)
    np.testing.assert_allclose(TanhNormal(2).log_prob(parameters, raw), density.sum(), rtol=1e-5)
    np.testing.assert_allclose(TanhNormal(2).mode(parameters), np.tanh([0.3, -0.8]), rtol=1e-5)


def test_networks_start_glorot_uniform_with_zero_biases():
    params = jax.jit(mlp((256, 256), 3).init)(jax.random.key(0), jnp.zeros(12))["params"]
    kernel = np.asarray(params["hidden_0"]["kernel"])
    bound = np.sqrt(6 / (12 + 256))
    assert 0.98 * bound < np.abs(kernel).max() <= bound
    assert all(not layer["bias"].any() for layer in params.values())
    assert jax.tree.map(np.shape, params)["hidden_2"]["kernel"] == (256, 3)


def lower_update(precision, critics=2, layer_norm=False):
    """Return the lowered update of the agents of two lanes, and its arguments."""
    sac, keys = SMALL.replace(precision=precision, layer_norm=layer_norm), jax.random.split(jax.random.key(0), 2)
    agents = jax.jit(jax.vmap(lambda key: sac_lib.init(key, sac, 4, 2, critics)))(keys)
    update = jax.jit(jax.vmap(functools.partial(sac_lib.update, sac), (0, None, 0)))
    arguments = agents, make_batch(), keys
    return update.lower(*arguments), arguments


def relative_errors(actual, exact):
    """Return the relative distance of every leaf from `exact`."""
    return [
        np.linalg.norm(np.subtract(a, b)) / np.linalg.norm(b)
        for a, b in zip(jax.tree.leaves(actual), jax.tree.leaves(exact), strict=True)
    ]


@pytest.mark.parametrize(("critics", "layer_norm"), [(4, False), (2, True)])
def test_bf16_differs_from_float32_only_by_rounding(critics, layer_norm):
    after = {}
    for precision in ("float32", "bf16"):
        lowered, arguments = lower_update(precision, critics, layer_norm)
        after[precision] = lowered.compile()(*arguments)[0]
    for network in ("critics", "actor"):
        exact, coarse = (after[name].moments[network].mu for name in ("float32", "bf16"))
        assert 0 < max(relative_errors(coarse, exact)) < 0.15
    assert {leaf.dtype for leaf in jax.tree.leaves(after["bf16"])} <= {jnp.dtype("float32"), jnp.dtype("int32")}


def test_float32_requests_full_float32_forward_and_backward_and_tf32_does_not():
    texts = {precision: lower_update(precision)[0].as_text() for precision in ("float32", "tf32")}
    products = [line for line in texts["float32"].splitlines() if "dot_general" in line]
    assert len(products) > 15
    assert all("HIGHEST" in line for line in products)
    assert "HIGHEST" not in texts["tf32"]


@pytest.mark.parametrize(("hidden_sizes", "outputs"), [((), 5), ((16,), 1), ((32, 16), 5), ((24, 24, 24), 1)])
def test_bf16_networks_have_the_gradients_of_float32(hidden_sizes, outputs):
    """Biases keep every unit far from the kink of its ReLU, so that the two differ by rounding alone."""
    network = mlp(hidden_sizes, outputs)
    keys = jax.random.split(jax.random.key(0), 2)
    blank = jax.jit(network.init)(keys[0], jnp.zeros(7))
    params = jax.tree.map(lambda leaf: 4.0 * (-1.0) ** np.arange(len(leaf)) if leaf.ndim == 1 else leaf, blank)
    x = 0.3 * jax.random.normal(keys[1], (3, 40, 7))

    def outputs_and_gradients(precision):
        out, pull = jax.vjp(lambda p, x: apply(network, p, x, precision), params, x)
        return out, *pull(1 + 0.5 * jnp.cos(jnp.arange(out.size, dtype=jnp.float32)).reshape(out.shape))

    exact, coarse = [jax.jit(outputs_and_gradients, static_argnums=0)(precision) for precision in ("float32", "bf16")]
    assert max(relative_errors(coarse, exact)) < 0.02
    assert {leaf.dtype for leaf in jax.tree.leaves(coarse)} == {jnp.dtype("float32")}
    single = jax.jit(lambda: apply(network, params, x[0, 0], "bf16"))()
    np.testing.assert_allclose(single, coarse[0][0, 0], rtol=1e-5, atol=1e-5)


def test_an_unknown_precision_is_an_error_that_lists_the_choices():
    for build in (lambda: make_algo("naive", precision="fp8"), lambda: SMALL.replace(precision="fp8")):
        with pytest.raises(ValueError, match="'fp8' is not one of float32, tf32, bf16"):
            build()


def test_an_update_moves_actor_targets_and_temperature():
    agent = init(jax.random.key(0), SMALL, 4, 2)
    after, diagnostics = jax.jit(lambda a, b, k: sac_lib.update(SMALL, a, b, k))(agent, make_batch(), jax.random.key(1))
    before, after = jax.device_get((agent, after))
    drift = jax.tree.map(
        lambda t, s, c: np.abs(t - (s + 0.005 * (c - s))).max(), after.targets, before.targets, after.critics
    )
    assert max(jax.tree.leaves(drift)) < 1e-6
    assert float(diagnostics["entropy"]) > -1.0
    assert float(after.log_temperature) == pytest.approx(-3e-4, rel=1e-3)
    assert min(jax.tree.leaves(jax.tree.map(lambda a, b: np.abs(a - b).max(), after.actor, before.actor))) > 0


def test_a_fixed_temperature_stays():
    agent = init(jax.random.key(0), SMALL, 4, 2)
    for fixed in (True, False):
        after = sac_lib._update_temperature(SMALL.replace(fixed_temperature=fixed), agent, jnp.float32(-3.0), 2)
        assert (float(after.log_temperature) == float(agent.log_temperature)) == fixed


def test_sac_solves_a_chain_of_known_value():
    """Two states in a row. An action > 0 earns 0 in the first state and leads to the second, where it earns 1 and ends.

    Any other action ends at once, with 0.2 in the first state and 0 in the second. The best return is gamma; a policy that stops
    at once earns 0.2. The entropy-free pair must learn the true values.
    """
    sac = SMALL.replace(learning_rate=3e-3, initial_temperature=0.1, target_rate=0.02, discount=0.9)
    rng = np.random.default_rng(0)
    is_second, action = rng.random(2000) < 0.5, rng.uniform(-1, 1, (2000, 1)).astype(np.float32)
    go = action[:, 0] > 0
    obs = np.stack([is_second, ~is_second], axis=1).astype(np.float32)
    reward = np.where(is_second, go, 0.2 * ~go).astype(np.float32)
    data = Batch(obs, action, reward, is_second | ~go, np.tile(np.float32([1.0, 0.0]), (2000, 1)))

    @jax.jit
    def learn(agent, keys):
        def step(agent, key):
            pick = jax.random.randint(key, (64,), 0, 2000)
            return sac_lib.update(sac, agent, jax.tree.map(lambda leaf: jnp.asarray(leaf)[pick], data), key)

        return jax.lax.scan(step, agent, keys)[0]

    agent = learn(init(jax.random.key(0), sac, 2, 1, critics=4), jax.random.split(jax.random.key(9), 3000))
    states = np.float32([[0.0, 1.0], [1.0, 0.0]])
    best = jax.jit(lambda: sac_lib.greedy(sac, agent.actor, states, 1))()
    assert (best > 0.1).all()
    for action, expected in ((best, [0.9, 1.0]), (-np.full((2, 1), 0.6, np.float32), [0.2, 0.0])):
        values = q_values(sac, agent.critics, states, action)[2:]
        np.testing.assert_allclose(values.mean(axis=0), expected, atol=0.1)
