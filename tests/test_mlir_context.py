"""The programs of the tests are lowered in one MLIR context, which changes none of them."""

import jax
import jax.numpy as jnp
import pytest

from tests import mlir_context

pytestmark = pytest.mark.skipif(
    mlir_context.jax_mlir is None, reason="this release of JAX keeps its lowering elsewhere"
)


def lower(scale):
    """Return a program that JAX has not lowered yet."""
    return jax.jit(lambda x: jnp.where(x > 0, scale * jnp.sin(x), 0.0)).lower(jnp.ones(3))


def test_programs_share_a_context():
    contexts = [lower(scale).compiler_ir("stablehlo").context for scale in (1.0, 2.0)]
    assert contexts[0] is contexts[1] is mlir_context.jax_mlir.make_ir_context()


def test_the_program_is_that_of_a_context_of_its_own(monkeypatch):
    shared = lower(3.0)
    monkeypatch.setattr(mlir_context.jax_mlir, "make_ir_context", mlir_context.jax_mlir.make_ir_context.__wrapped__)
    alone = lower(3.0)
    assert alone.compiler_ir("stablehlo").context is not shared.compiler_ir("stablehlo").context
    assert shared.as_text() == alone.as_text()
