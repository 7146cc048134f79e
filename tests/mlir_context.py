"""One MLIR context for all programs of a process: JAX creates one for every program that it lowers.

A context registers all operations of its dialects, which takes longer than the lowering of a small program, and JAX's
caches keep it alive, so that each takes longer than the one before. The tests compile thousands of small programs.
"""

import functools

try:
    from jax._src.interpreters import mlir as jax_mlir
except ImportError:  # another release keeps it elsewhere, and lowers as it does for users
    jax_mlir = None


def install():
    """Let JAX lower all programs in one context."""
    if jax_mlir is not None and not hasattr(jax_mlir.make_ir_context, "cache_info"):
        jax_mlir.make_ir_context = functools.cache(jax_mlir.make_ir_context)
