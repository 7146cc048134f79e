"""Forward and backward passes of the learner's networks in bfloat16, with float32 parameters, gradients and sums.

Automatic differentiation would write float32 copies of activations and cotangents. These passes keep both in bfloat16.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
from flax import linen

Weights = tuple[tuple[jax.Array, jax.Array], ...]
Saved = tuple[list[jax.Array], list[jax.Array]]


def apply(network: Any, layers: Any, x: jax.Array) -> jax.Array:
    """Return the float32 outputs [B, O] of an `MLP` with the parameters `layers` at `x [B, K]`."""
    if len(network.layer_sizes) == 1 or network.layer_norm:
        return _apply_normalised(network, layers, x)
    names = [f"hidden_{number}" for number in range(len(network.layer_sizes))]
    return _perceptron(tuple((layers[name]["kernel"], layers[name]["bias"]) for name in names), x)


def _dot(a: jax.Array, b: jax.Array, over: tuple[int, int] = (1, 0), dtype: Any = jnp.bfloat16) -> jax.Array:
    """Return the product of two bfloat16 matrices, contracted over the axes `over`, in `dtype`; sums are float32."""
    if jax.default_backend() == "cpu":  # CPUs multiply bfloat16 into bfloat16 only
        a, b = a.astype(jnp.float32), b.astype(jnp.float32)
    out = jax.lax.dot_general(a, b, (((over[0],), (over[1],)), ((), ())), preferred_element_type=dtype)
    return out.astype(dtype)


@jax.custom_vjp
def _perceptron(weights: Weights, x: jax.Array) -> jax.Array:
    """Return the float32 outputs [B, O] of the ReLU network with the kernels and biases `weights` at `x [B, K]`.

    The backward pass is written by hand. It masks by the saved activations and keeps cotangents in bfloat16, where
    automatic differentiation would write float32 copies of both. The first bias is an additional row of its kernel, and
    the inputs have an additional column of ones, so that one product computes the gradients of kernel and bias.
    """
    return _forward(weights, x)[0]


def _forward(weights: Weights, x: jax.Array) -> tuple[jax.Array, Saved]:
    """Return the outputs and, for the backward pass, the kernel and inputs of every layer in bfloat16."""
    (first, bias), *others = weights
    kernels = [jnp.concatenate([first, bias[None]]), *(kernel for kernel, _ in others)]
    lows = [kernel.astype(jnp.bfloat16) for kernel in kernels]
    inputs = jnp.concatenate([x, jnp.ones_like(x[:, :1])], axis=1).astype(jnp.bfloat16)
    if lows[-1].shape[1] > 1:  # an actor: XLA would merge its forward passes at two batches and then split them again
        lows, inputs = jax.lax.optimization_barrier((lows, inputs))
    rows = [inputs, jnp.maximum(_dot(inputs, lows[0]), 0)]
    for low, (_, bias) in zip(lows[1:-1], others[:-1], strict=True):
        rows.append(jnp.maximum(_dot(rows[-1], low) + bias, 0).astype(jnp.bfloat16))
    return _dot(rows[-1], lows[-1], dtype=jnp.float32) + others[-1][1], (lows, rows)


def _backward(saved: Saved, gradient: jax.Array) -> tuple[Weights, jax.Array]:
    """Return the float32 gradients of the weights and of `x`, given the outputs' `gradient [B, O]`."""
    lows, rows = saved
    low, above = gradient.astype(jnp.bfloat16), lows[-1]
    if above.shape[1] == 1:  # with one output, both products are elementwise
        kernel = (rows[-1].astype(jnp.float32) * gradient).sum(axis=0)[:, None]
        low = (gradient * above[:, 0]).astype(jnp.bfloat16)
    else:
        kernel, low = _dot(rows[-1], low, (0, 0), jnp.float32), _dot(low, above, (1, 1))
    gradients = [(kernel, gradient.sum(axis=0))]
    for number in reversed(range(1, len(lows) - 1)):
        low = jax.lax.optimization_barrier(jnp.where(rows[number + 1] > 0, low, 0))  # the next product needs no sum
        gradients.append((_dot(rows[number], low, (0, 0), jnp.float32), low.astype(jnp.float32).sum(axis=0)))
        low = _dot(low, lows[number], (1, 1))
    low = jnp.where(rows[1] > 0, low, 0)
    first = _dot(rows[0], low, (0, 0), jnp.float32)
    gradients.append((first[:-1], first[-1]))
    return tuple(reversed(gradients)), _dot(low, lows[0][:-1], (1, 1), jnp.float32)


_perceptron.defvjp(_forward, _backward)


def _apply_normalised(network: Any, layers: Any, x: jax.Array) -> jax.Array:
    """Return the outputs of any network; hidden activations are bfloat16, biases, normalisation and outputs float32."""
    hidden, last = x.astype(jnp.bfloat16), len(network.layer_sizes) - 1
    for number in range(last):
        layer = layers[f"hidden_{number}"]
        hidden = linen.relu(_product(jnp.bfloat16, hidden, layer["kernel"]) + layer["bias"])
        if network.layer_norm:
            hidden = linen.LayerNorm().apply({"params": layers[f"LayerNorm_{number}"]}, hidden)
        hidden = jnp.asarray(hidden).astype(jnp.bfloat16)
    return _product(jnp.float32, hidden, layers[f"hidden_{last}"]["kernel"]) + layers[f"hidden_{last}"]["bias"]


@functools.partial(jax.custom_vjp, nondiff_argnums=(0,))
def _product(dtype: Any, x: jax.Array, kernel: jax.Array) -> jax.Array:
    """Return `x @ kernel` in `dtype` for bfloat16 `x [B, K]` and a float32 `kernel`, with a float32 gradient."""
    return _product_forward(dtype, x, kernel)[0]


def _product_forward(dtype: Any, x: jax.Array, kernel: jax.Array) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
    low = kernel.astype(jnp.bfloat16)
    return _dot(x, low, dtype=dtype), (x, low)


def _product_backward(dtype: Any, saved: tuple[jax.Array, jax.Array], gradient: jax.Array) -> tuple:
    """Return the gradients of `x` and `kernel` from bfloat16 products; the default rule would multiply in float32."""
    (x, low), gradient = saved, gradient.astype(jnp.bfloat16)
    return _dot(gradient, low, (1, 1)), _dot(x, gradient, (0, 0), jnp.float32)


_product.defvjp(_product_forward, _product_backward)
