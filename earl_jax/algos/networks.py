"""The learner's networks: Brax's multilayer perceptron and tanh-squashed normal, with the paper's parameters.

`apply` runs a network at a chosen precision; parameters are float32 at every one.
"""

import contextlib
import functools
import io
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from flax import linen

# Brax imports MJX, which prints a line to stdout for each optional engine that is not installed; stdout may be JSON.
with contextlib.redirect_stdout(io.StringIO()):
    from brax.training import distribution, networks

LOG_STD_RANGE = (-20.0, 2.0)
PRECISIONS = ("float32", "tf32", "bf16")
Weights = tuple[tuple[jax.Array, jax.Array], ...]


class Ways(NamedTuple):
    """How bf16 networks are written for XLA; each is a choice that only a measurement decides."""

    hand: bool = True
    """Write the backward pass by hand: masks from the saved activations, no float32 copy of anything but results."""
    sums: bool = True
    """Sum over the batch by products with the column of ones instead of reductions."""
    mask: bool = False
    """Scale a single output's cotangent after its product instead of before, so that the mask is the operand."""
    spread: bool = True
    """Repeat inputs for every critic, so that all products of a stack have one batch axis."""
    apart: bool = True
    """Keep the actor's two forward passes apart, which XLA would merge and then cut again."""
    split: bool = True
    """Keep the products with the column of ones apart from those with activations."""
    wide: bool = True
    """Round hidden sums after their bias instead of before, so that both can be part of the product's kernel."""


WAYS = Ways()


class TanhNormal(distribution.NormalTanhDistribution):
    """Tanh-squashed normal whose log standard deviation is the clipped network output, as in the paper.

    Brax's own passes it through a softplus; everything else is Brax's.
    """

    def create_dist(self, parameters: jax.Array) -> Any:
        """Return the normal before squashing, from `parameters [..., 2a]`: means, then log standard deviations."""
        loc, log_std = jnp.split(parameters, 2, axis=-1)
        return type(super().create_dist(parameters))(loc, jnp.exp(jnp.clip(log_std, *LOG_STD_RANGE)))


def mlp(hidden_sizes: tuple[int, ...], outputs: int, layer_norm: bool = False) -> networks.MLP:
    """Return a ReLU network with Glorot-uniform weights and zero biases, as the released TF-Agents code has them.

    `layer_norm` normalises every hidden layer.
    """
    init = jax.nn.initializers.glorot_uniform()
    return networks.MLP([*hidden_sizes, outputs], activation=linen.relu, kernel_init=init, layer_norm=layer_norm)


def check_precision(precision: str) -> None:
    """Refuse a precision that `apply` does not know, by a ValueError."""
    if precision not in PRECISIONS:
        raise ValueError(f"precision {precision!r} is not one of {', '.join(PRECISIONS)}")


def apply(network: networks.MLP, params: Any, x: jax.Array, precision: str = "tf32") -> jax.Array:
    """Return the float32 outputs [..., O] of `network` at `x [..., K]`, differentiable in `params` and `x`.

    "float32" multiplies matrices in float32 on every device, "tf32" at XLA's default (TF32 on NVIDIA GPUs, float32 on
    CPUs), "bf16" with bfloat16 operands and activations, sums in float32.
    """
    if precision == "bf16":
        if network.layer_norm or len(network.layer_sizes) == 1 or not WAYS.hand:
            return _apply_normalised(network, params, x)
        layers = [params["params"][f"hidden_{number}"] for number in range(len(network.layer_sizes))]
        weights = tuple((layer["kernel"], layer["bias"]) for layer in layers)
        return _perceptron(weights, x.reshape(-1, x.shape[-1])).reshape(*x.shape[:-1], -1)
    with jax.default_matmul_precision("highest") if precision == "float32" else contextlib.nullcontext():
        return jnp.asarray(network.apply(params, x))


def _dot(a: jax.Array, b: jax.Array, over: tuple[int, int] = (1, 0), dtype: Any = jnp.bfloat16) -> jax.Array:
    """Return the product of bfloat16 matrices over these axes in `dtype`, summed in float32."""
    if jax.default_backend() == "cpu":  # whose products of bfloat16 give nothing else
        a, b = a.astype(jnp.float32), b.astype(jnp.float32)
    out = jax.lax.dot_general(a, b, (((over[0],), (over[1],)), ((), ())), preferred_element_type=dtype)
    return out.astype(dtype)


@jax.custom_vjp
def _perceptron(weights: Weights, x: jax.Array) -> jax.Array:
    """Return the float32 outputs [B, O] of the ReLU network of these weights at `x [B, K]`, bfloat16 inside.

    The first bias is one more row of its kernel, for a column of ones beside the inputs, whose products also sum over
    the batch: XLA's reductions that write activations too are several times slower.
    """
    return _forward(weights, x)[0]


def _forward(weights: Weights, x: jax.Array) -> tuple[jax.Array, tuple[list[jax.Array], list[jax.Array]]]:
    """Return the outputs, and for the backward pass the kernels and every layer's inputs in bfloat16."""
    lows = [kernel.astype(jnp.bfloat16) for kernel, _ in weights]
    lows[0] = jnp.concatenate([lows[0], weights[0][1][None].astype(jnp.bfloat16)])
    values = jnp.concatenate([x, jnp.ones_like(x[:, :1])], axis=1).astype(jnp.bfloat16)
    several = weights[-1][1].shape[0] > 1
    if WAYS.apart and several:
        lows, values = jax.lax.optimization_barrier((lows, values))
    rows = [values, jnp.maximum(_dot(values, lows[0]), 0)]
    for low, (_, bias) in zip(lows[1:-1], weights[1:-1], strict=True):
        after = _dot(rows[-1], low, dtype=jnp.float32 if WAYS.wide and several else jnp.bfloat16) + bias
        rows.append(jnp.maximum(after, 0).astype(jnp.bfloat16))
    return _dot(rows[-1], lows[-1], dtype=jnp.float32) + weights[-1][1], (lows, rows)


def _backward(residuals: tuple[list[jax.Array], list[jax.Array]], gradient: jax.Array) -> tuple[Weights, jax.Array]:
    """Return the float32 gradients of weights and inputs; cotangents of hidden layers are bfloat16."""
    lows, rows = residuals
    low, scale = gradient.astype(jnp.bfloat16), None
    gradients = [(_last_kernel(rows, gradient), gradient.sum(axis=0))]
    for number in reversed(range(len(rows) - 1)):
        active, above = rows[number + 1] > 0, lows[number + 1]
        if number == len(rows) - 2 and above.shape[1] == 1:
            scale = gradient if WAYS.mask else None
            low = jnp.where(active, above[:, 0] if WAYS.mask else (gradient * above[:, 0]).astype(jnp.bfloat16), 0)
        else:
            low = jnp.where(active, _dot(low, above, (1, 1)), 0)
        gradients.append(_hidden_layer(rows, number, low, scale))
    dx = _dot(low, lows[0][:-1], (1, 1), jnp.float32)
    return tuple(reversed(gradients)), dx if scale is None else dx * scale


_perceptron.defvjp(_forward, _backward)


def _last_kernel(rows: list[jax.Array], gradient: jax.Array) -> jax.Array:
    if gradient.shape[1] > 1:
        return _dot(rows[-1], gradient.astype(jnp.bfloat16), (0, 0), jnp.float32)
    if not WAYS.sums:
        return (rows[-1].astype(jnp.float32) * gradient).sum(axis=0)[:, None]
    return _dot(rows[-1], (rows[0] * gradient).astype(jnp.bfloat16), (0, 0), jnp.float32)[:, -1:]


def _hidden_layer(rows: list[jax.Array], number: int, low: jax.Array, scale: jax.Array | None) -> tuple:
    """Return the gradients of a hidden layer's kernel and bias for the cotangent `low [B, H]`, times `scale [B, 1]`."""

    def scaled(values):
        return values if scale is None else (values * scale).astype(jnp.bfloat16)

    kernel = _dot(scaled(rows[number]), low, (0, 0), jnp.float32)
    if number == 0:
        return kernel[:-1], kernel[-1]
    if not WAYS.sums:
        return kernel, (low.astype(jnp.float32) * (1.0 if scale is None else scale)).sum(axis=0)
    inputs = scaled(rows[0])
    inputs, low = jax.lax.optimization_barrier((inputs, low)) if WAYS.split else (inputs, low)
    return kernel, _dot(inputs, low, (0, 0), jnp.float32)[-1]


def _apply_normalised(network: networks.MLP, params: Any, x: jax.Array) -> jax.Array:
    """Return `network` at `x` with hidden activations in bfloat16, biases, normalisation and outputs in float32."""
    layers, hidden, last = params["params"], x.astype(jnp.bfloat16), len(network.layer_sizes) - 1
    for number in range(last):
        layer = layers[f"hidden_{number}"]
        hidden = linen.relu(_product(jnp.bfloat16, hidden, layer["kernel"]) + layer["bias"])
        if network.layer_norm:
            hidden = linen.LayerNorm().apply({"params": layers[f"LayerNorm_{number}"]}, hidden)
        hidden = jnp.asarray(hidden).astype(jnp.bfloat16)
    return _product(jnp.float32, hidden, layers[f"hidden_{last}"]["kernel"]) + layers[f"hidden_{last}"]["bias"]


def _matmul(dtype: Any, a: jax.Array, b: jax.Array) -> jax.Array:
    """Return the product of bfloat16 matrices in `dtype`, summed in float32; XLA's CPU has that only for float32."""
    if jax.default_backend() == "cpu":
        return jnp.matmul(a.astype(jnp.float32), b.astype(jnp.float32)).astype(dtype)
    return jnp.matmul(a, b, preferred_element_type=dtype)


@functools.partial(jax.custom_vjp, nondiff_argnums=(0,))
def _product(dtype: Any, x: jax.Array, kernel: jax.Array) -> jax.Array:
    """Return `x @ kernel` in `dtype` for bfloat16 `x` and a float32 `kernel`, whose gradient is float32."""
    return _matmul(dtype, x, kernel.astype(jnp.bfloat16))


def _product_forward(dtype: Any, x: jax.Array, kernel: jax.Array) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
    low = kernel.astype(jnp.bfloat16)
    return _matmul(dtype, x, low), (x, low)


def _product_backward(dtype: Any, residuals: tuple[jax.Array, jax.Array], gradient: jax.Array) -> tuple:
    """Without a rule of its own a product in float32 would multiply its float32 gradient in float32 too."""
    del dtype
    (x, low), gradient = residuals, gradient.astype(jnp.bfloat16)
    dx = _matmul(jnp.bfloat16, gradient, low.T)
    rows, sums = x.reshape(-1, x.shape[-1]), gradient.reshape(-1, gradient.shape[-1])
    return dx, _matmul(jnp.float32, rows.T, sums)


_product.defvjp(_product_forward, _product_backward)
