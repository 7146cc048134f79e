"""The problems that the tests of every learner share."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.algos.learner.base import Batch

ROWS, SIZE = 8, 2


@pytest.fixture(scope="module")
def batch():
    """Random transitions, of which the first is terminal and every fourth demonstrated."""
    rng, rows = np.random.default_rng(0), np.arange(ROWS)
    obs, next_obs = rng.normal(size=(2, ROWS, 4)).astype(np.float32)
    action, reward = rng.uniform(-1, 1, (ROWS, SIZE)).astype(np.float32), rng.normal(size=ROWS).astype(np.float32)
    return Batch(obs, action, reward, rows == 0, next_obs, demonstrated=rows % 4 == 1, step=np.int32(0))


CHAIN_STATES = np.float32([[0.0, 1.0], [1.0, 0.0]])


@pytest.fixture(scope="module")
def chain():
    """2000 transitions of two states in a row, `CHAIN_STATES`.

    An action > 0 earns 0 in the first state and leads to the second, where it earns 1 and ends. Any other action ends at
    once, with 0.2 in the first state and 0 in the second. The best return is gamma; a policy that stops at once earns 0.2.
    """
    rng = np.random.default_rng(0)
    is_second, action = rng.random(2000) < 0.5, rng.uniform(-1, 1, (2000, 1)).astype(np.float32)
    go = action[:, 0] > 0
    obs = np.stack([is_second, ~is_second], axis=1).astype(np.float32)
    reward = np.where(is_second, go, 0.2 * ~go).astype(np.float32)
    return Batch(obs, action, reward, is_second | ~go, np.tile(np.float32([1.0, 0.0]), (2000, 1)))


def learnt(learner, agent, transitions):
    """Return `agent` after 1500 updates, each on 64 random ones of the `transitions`, in one program."""

    def step(agent, number):
        key = jax.random.fold_in(jax.random.key(9), number)
        rows = jax.random.randint(key, (64,), 0, len(transitions.reward))
        batch = jax.tree.map(lambda leaf: jnp.asarray(leaf)[rows], transitions)._replace(step=number)
        return learner.update(key, agent, batch)[0], None

    return jax.jit(lambda agent: jax.lax.scan(step, agent, jnp.arange(1500))[0])(agent)
