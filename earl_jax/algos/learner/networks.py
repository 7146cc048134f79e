"""The learner's networks: a multilayer perceptron, a tanh-squashed normal with the paper's parameters, a step of Adam.

`apply` evaluates a network at a chosen precision; parameters are always float32. The layers are derived from the
parameters, so callers need not pass their sizes.
"""

import contextlib
import math
from typing import Any

import jax
import jax.numpy as jnp
import optax
from flax import linen

from earl_jax.algos.learner import bf16

LOG_STD_RANGE = (-20.0, 2.0)
PRECISIONS = ("float32", "tf32", "bf16")
ADAM = optax.scale_by_adam()


def descend(params: Any, grads: Any, moments: Any, rate: float) -> tuple[Any, Any]:
    """Return parameters and Adam moments after one descent step of size `rate` along `grads`."""
    direction, moments = ADAM.update(grads, moments)
    return jax.tree.map(lambda p, d: p - rate * d, params, direction), moments


def follow(slow: Any, fast: Any, rate: Any) -> Any:
    """Return the parameters `slow` after a move towards `fast` by the share `rate` of the difference."""
    return jax.tree.map(lambda old, new: old + rate * (new - old), slow, fast)


class MLP(linen.Module):
    """ReLU network of layers `hidden_0`, `hidden_1`, ... with `layer_sizes` outputs, the last one linear.

    Weights start Glorot-uniform and biases at zero, as in the released TF-Agents code. `layer_norm` normalises every
    hidden layer after its activation.
    """

    layer_sizes: tuple[int, ...]
    layer_norm: bool = False

    @linen.compact
    def __call__(self, x: jax.Array) -> jax.Array:
        """Return the outputs [..., O] at `x [..., K]`."""
        init = jax.nn.initializers.glorot_uniform()
        for number, size in enumerate(self.layer_sizes):
            if number:
                x = linen.relu(x)
                x = linen.LayerNorm()(x) if self.layer_norm else x
            x = linen.Dense(size, kernel_init=init, name=f"hidden_{number}")(x)
        return x


def apply(params: Any, x: jax.Array, precision: str = "tf32") -> jax.Array:
    """Return the float32 outputs [..., O] of the `MLP` with `params` at `x [..., K]`, differentiable in both.

    `precision` chooses the matrix products: "float32" on every device; "tf32", XLA's default (TF32 on NVIDIA GPUs,
    float32 on CPUs); or "bf16", with bfloat16 operands and activations and float32 sums.
    """
    layers = params["params"]
    count = sum(name.startswith("hidden") for name in layers)
    sizes = tuple(layers[f"hidden_{number}"]["bias"].shape[-1] for number in range(count))
    network = MLP(sizes, layer_norm=len(layers) > count)
    if precision == "bf16":
        rows = x.reshape(math.prod(x.shape[:-1]), x.shape[-1])
        return bf16.apply(network, layers, rows).reshape(*x.shape[:-1], sizes[-1])
    with jax.default_matmul_precision("highest") if precision == "float32" else contextlib.nullcontext():
        return jnp.asarray(network.apply(params, x))


def q_values(critics: Any, obs: jax.Array, action: jax.Array, precision: str = "tf32") -> jax.Array:
    """Return the values [K, ...] of K stacked critics, leaves [K, ...], at `obs [..., o]` and `action [..., a]`."""
    pair, axis = jnp.concatenate([obs, action], axis=-1), None
    if precision == "bf16":  # repeated for every critic, so that all products of the stack have one batch axis
        pair, axis = jnp.broadcast_to(pair, (jax.tree.leaves(critics)[0].shape[0], *pair.shape)), 0
    return jax.vmap(lambda critic, x: apply(critic, x, precision), (0, axis))(critics, pair)[..., 0]


def sample_tanh_normal(parameters: jax.Array, key: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return squashed actions [..., a], reparametrised, and their log-densities [...].

    `parameters [..., 2a]` are the means, then the log standard deviations before clipping, as in the paper.
    """
    mean, std = _moments(parameters)
    raw = jax.random.normal(key, mean.shape) * std + mean
    return jnp.tanh(raw), tanh_log_prob(parameters, raw)


def mode(parameters: jax.Array) -> jax.Array:
    """Return the squashed means [..., a]."""
    return jnp.tanh(_moments(parameters)[0])


def tanh_log_prob(parameters: jax.Array, raw: jax.Array) -> jax.Array:
    """Return the log-densities [...] of the actions tanh(`raw [..., a]`) (appendix C of the SAC paper)."""
    mean, std = _moments(parameters)
    normal = -0.5 * jnp.square(raw / std - mean / std) - (0.5 * jnp.log(2.0 * jnp.pi) + jnp.log(std))
    return (normal - 2.0 * (jnp.log(2.0) - raw - jax.nn.softplus(-2.0 * raw))).sum(axis=-1)


def _moments(parameters: jax.Array) -> tuple[jax.Array, jax.Array]:
    mean, log_std = jnp.split(parameters, 2, axis=-1)
    return mean, jnp.exp(jnp.clip(log_std, *LOG_STD_RANGE))


def fix_log_std(params: Any, value: float) -> Any:
    """Return the parameters of a policy, with any leading axes, with every log standard deviation set to `value`."""
    layers = dict(params["params"])
    last = f"hidden_{len(layers) - 1}"
    size = layers[last]["bias"].shape[-1] // 2
    fixed = {"kernel": 0.0, "bias": value}
    layers[last] = {name: leaf.at[..., size:].set(fixed[name]) for name, leaf in layers[last].items()}
    return {"params": layers}
