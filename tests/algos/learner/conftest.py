"""The problems that the tests of every learner share."""

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
