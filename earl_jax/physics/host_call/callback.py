"""Host work through `jax.pure_callback`, the fallback for a process in which XLA refuses the foreign function."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

INLINE_BYTES = 100_000
"""The largest operand of a callback. A thread of XLA's pool copies operands above 102,400 bytes, and if a program on each
CPU device waits for its copy, no thread is left: two devices with 260 lanes each of 101 numbers stopped so."""


def step(serve: Callable[[np.ndarray], np.ndarray], row: jax.Array, width: int) -> jax.Array:
    """Return the answer [width] of `serve` to one lane's `row [k]`, float32; vmap makes a single call.

    `serve` maps rows [n, k] to rows [n, width].
    """

    def join_and_serve(*parts: jax.Array) -> np.ndarray:
        return serve(np.concatenate([np.asarray(part) for part in parts]))

    @jax.custom_batching.custom_vmap
    def answer(rows: jax.Array) -> jax.Array:
        flat = rows.reshape(-1, rows.shape[-1])
        lanes = max(1, INLINE_BYTES // flat[:1].nbytes)
        parts = [flat[first : first + lanes] for first in range(0, len(flat), lanes)]
        shape = jax.ShapeDtypeStruct((len(flat), width), jnp.float32)
        return jax.pure_callback(join_and_serve, shape, *parts).reshape(*rows.shape[:-1], width)

    answer.def_vmap(lambda lanes, batched, rows: (answer(rows), True))
    return answer(row)
