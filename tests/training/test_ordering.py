"""Order inside a compiled program."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.training.ordering import UNLIKELY, after

VALUE = jnp.array([3, -1], jnp.int32)
DEPENDENCIES = [
    (jnp.ones((2, 3)),),
    (jnp.zeros(2, bool), jnp.arange(4)),
    ({"weights": jnp.full(3, 0.5), "bias": (jnp.zeros(()),)}, None),
]


def main_arguments(function, *arguments):
    """Return how many arguments the lowered program takes; jit drops those that its result does not depend on."""
    return jax.jit(function).lower(*arguments).as_text().partition("@main(")[2].partition("->")[0].count("%arg")


@pytest.mark.parametrize("dependencies", DEPENDENCIES)
def test_the_value_is_unchanged(dependencies):
    for run in (after, jax.jit(after)):
        result = run(VALUE, *dependencies)
        np.testing.assert_array_equal(result, VALUE)
        assert result.dtype == VALUE.dtype


@pytest.mark.parametrize("dependencies", [(), (None,), ({},)])
def test_the_value_itself_is_returned_without_dependencies(dependencies):
    assert after(VALUE, *dependencies) is VALUE


@pytest.mark.parametrize("dependencies", DEPENDENCIES)
def test_the_program_depends_on_every_array(dependencies):
    count = 1 + len(jax.tree.leaves(dependencies))
    assert main_arguments(after, VALUE, *dependencies) == count
    assert main_arguments(lambda value, *rest: value + 1, VALUE, *dependencies) == 1


def test_the_compiler_keeps_the_dependency():
    text = jax.jit(after).lower(VALUE, jnp.ones(3)).compile().as_text()
    assert f"constant({{{UNLIKELY:g}}})" in text
