"""What `jnp.asarray` gets outside programs becomes the array that JAX makes of it, without a program."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests import staging

pytestmark = pytest.mark.skipif(
    staging.stage_p is None, reason="this release of JAX has no operation that stages a value"
)
VALUES = [3.5, 2, True, np.float32(1.5), np.int64(7), np.arange(6.0).reshape(2, 3), np.zeros((0, 3), bool)]


@pytest.mark.parametrize("value", VALUES, ids=repr)
def test_an_array_is_that_of_a_program(value):
    placed, staged = jnp.asarray(value), jax.jit(lambda: jnp.asarray(value))()
    assert jax.typeof(placed) == jax.typeof(staged)
    np.testing.assert_array_equal(np.asarray(placed), np.asarray(staged))


def test_a_new_shape_compiles_nothing(caplog):
    with jax.log_compiles(), caplog.at_level("WARNING"):
        jnp.asarray(np.ones((7, 11, 13)))
        assert "Compiling" not in caplog.text
        jnp.ones((7, 11, 13)) + 1
    assert "Compiling" in caplog.text


def test_an_array_keeps_its_numbers_when_numpy_changes_its_own():
    source = np.zeros(1000, np.float32)
    array = jnp.asarray(source)
    source[:] = 1
    np.testing.assert_array_equal(array, 0)
