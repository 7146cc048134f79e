"""Every learner on a problem of known value."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.algos.learner.base import Batch
from earl_jax.algos.learner.sac import SAC
from earl_jax.algos.learner.td3 import TD3

STATES = np.float32([[0.0, 1.0], [1.0, 0.0]])
OPTIONS = {"hidden_sizes": (32, 32), "reward_scale": 1.0, "learning_rate": 3e-3, "target_rate": 0.02, "discount": 0.9}


def chain():
    """Return 2000 transitions of two states in a row, `STATES`.

    An action > 0 earns 0 in the first state and leads to the second, where it earns 1 and ends. Any other action ends at
    once, with 0.2 in the first state and 0 in the second. The best return is gamma; a policy that stops at once earns 0.2.
    """
    rng = np.random.default_rng(0)
    is_second, action = rng.random(2000) < 0.5, rng.uniform(-1, 1, (2000, 1)).astype(np.float32)
    go = action[:, 0] > 0
    obs = np.stack([is_second, ~is_second], axis=1).astype(np.float32)
    reward = np.where(is_second, go, 0.2 * ~go).astype(np.float32)
    return Batch(obs, action, reward, is_second | ~go, np.tile(np.float32([1.0, 0.0]), (2000, 1)))


@pytest.mark.parametrize("learner", [SAC(initial_temperature=0.1, **OPTIONS), TD3(**OPTIONS)], ids=["sac", "td3"])
def test_a_learner_solves_a_chain_of_known_value(learner):
    """SAC's entropy-free pair, its last two critics, must learn the true values."""
    transitions = chain()

    @jax.jit
    def learnt():
        def step(agent, number):
            key = jax.random.fold_in(jax.random.key(9), number)
            rows = jax.random.randint(key, (64,), 0, len(transitions.reward))
            batch = jax.tree.map(lambda leaf: jnp.asarray(leaf)[rows], transitions)._replace(step=number)
            return learner.update(key, agent, batch)[0], None

        agent = learner.init(jax.random.key(0), 2, 1, entropy_free_pairs=1)
        agent = jax.lax.scan(step, agent, jnp.arange(1500))[0]
        best = learner.greedy(agent.actor, STATES)
        stop = jnp.full((2, 1), -0.6)
        return best, [learner.q_values(agent.critics, STATES, action)[-2:] for action in (best, stop)]

    best, values = learnt()
    assert (best > 0.1).all()
    np.testing.assert_allclose(np.mean(values, axis=1), [[0.9, 1.0], [0.2, 0.0]], atol=0.1)
