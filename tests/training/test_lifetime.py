"""A whole lifetime as one pure function."""

import jax
import numpy as np
import pytest

from earl_jax.algos import make_algo
from earl_jax.training import lifetime
from earl_jax.training.state import seed_keys
from tests.conftest import tiny_options, tiny_train


@pytest.mark.parametrize("algo", ["naive", "vaprl"])
def test_a_lifetime_under_jit_equals_training(problem, algo):
    result = tiny_train(algo)
    method = make_algo(algo, **tiny_options(algo))
    train_state, metrics = jax.jit(lambda keys: lifetime(problem, method, keys, 120))(seed_keys(range(2)))
    for name, values in metrics.items():
        np.testing.assert_allclose(values, result.metrics[name], rtol=1e-3, atol=1e-4, err_msg=name)
    np.testing.assert_allclose(train_state.replay.action, result.train_state.replay.action, atol=1e-3)
