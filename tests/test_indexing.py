"""Static indices of arrays outside programs give what JAX gives, without a program."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests import indexing

pytestmark = pytest.mark.skipif(indexing.ArrayImpl is None, reason="this release of JAX keeps its arrays elsewhere")


def indexed(array, index):
    """Return what the tests and what JAX takes from `array`."""
    return array[index], type(array).__getitem__.by_jax(array, index)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.bfloat16, jnp.int32, jnp.bool_])
@pytest.mark.parametrize("index", [1, -1, np.int64(2), slice(1, 3), (0, slice(None), None), (..., 0), (2, 1, 0)])
def test_the_elements_are_those_that_jax_takes(dtype, index):
    actual, expected = indexed(jnp.asarray(np.arange(24).reshape(4, 3, 2), dtype), index)
    assert jax.typeof(actual) == jax.typeof(expected)
    assert isinstance(actual, jax.Array)
    np.testing.assert_array_equal(np.asarray(actual), np.asarray(expected))


def test_keys_and_arrays_of_weak_type_are_left_to_jax():
    keys, weak = jax.random.split(jax.random.key(0), 3), jnp.full(3, 1.0)
    assert jnp.issubdtype(keys[1].dtype, jax.dtypes.prng_key)
    assert jax.typeof(weak[1]) == jax.typeof(indexed(weak, 1)[1])


def test_an_element_stays_when_its_array_is_given_away():
    array = jnp.arange(1000.0, dtype=jnp.float32)
    part = array[10:20]
    jax.jit(lambda x: x + 1, donate_argnums=0)(array).block_until_ready()
    np.testing.assert_array_equal(part, np.arange(10, 20))


def test_an_index_outside_the_array_is_an_error():
    with pytest.raises(IndexError):
        jnp.zeros(3, jnp.float32)[3]
