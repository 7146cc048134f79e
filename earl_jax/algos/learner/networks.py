"""The learner's networks: Brax's multilayer perceptron and tanh-squashed normal, with the paper's parameters.

`apply` evaluates a network at a chosen precision; parameters are always float32.
"""

import contextlib
import io
from typing import Any

import jax
import jax.numpy as jnp
from flax import linen

from earl_jax.algos.learner import bf16
from earl_jax.errors import InputError

# Brax imports MJX, which prints a line for each missing optional engine to stdout, where a caller may write JSON.
with contextlib.redirect_stdout(io.StringIO()):
    from brax.training import distribution, networks

LOG_STD_RANGE = (-20.0, 2.0)
PRECISIONS = ("float32", "tf32", "bf16")


class TanhNormal(distribution.NormalTanhDistribution):
    """Tanh-squashed normal whose log standard deviation is the clipped network output, as in the paper.

    Brax applies a softplus instead; the rest is unchanged.
    """

    def create_dist(self, parameters: jax.Array) -> Any:
        """Return the normal before squashing with `parameters [..., 2a]`: means, then log standard deviations."""
        loc, log_std = jnp.split(parameters, 2, axis=-1)
        return type(super().create_dist(parameters))(loc, jnp.exp(jnp.clip(log_std, *LOG_STD_RANGE)))


def mlp(hidden_sizes: tuple[int, ...], outputs: int, layer_norm: bool = False) -> networks.MLP:
    """Return a ReLU network with Glorot-uniform weights and zero biases, as in the released TF-Agents code.

    `layer_norm` normalises every hidden layer.
    """
    init = jax.nn.initializers.glorot_uniform()
    return networks.MLP([*hidden_sizes, outputs], activation=linen.relu, kernel_init=init, layer_norm=layer_norm)


def fix_input(params: Any, index: int, value: float) -> Any:
    """Return the parameters of a `mlp` for inputs [K - 1]: `params`, leaves [..., ...], with input `index` at `value`."""
    layers = dict(params["params"])
    kernel, bias = layers["hidden_0"]["kernel"], layers["hidden_0"]["bias"]
    rest = jnp.delete(kernel, index, axis=-2, assume_unique_indices=True)
    return {"params": {**layers, "hidden_0": {"kernel": rest, "bias": bias + value * kernel[..., index, :]}}}


def fix_log_std(params: Any, value: float) -> Any:
    """Return the parameters of a policy, leaves [..., ...], with every log standard deviation at `value`."""
    layers = dict(params["params"])
    last = f"hidden_{len(layers) - 1}"
    size = layers[last]["bias"].shape[-1] // 2
    fixed = {"kernel": 0.0, "bias": value}
    layers[last] = {name: leaf.at[..., size:].set(fixed[name]) for name, leaf in layers[last].items()}
    return {"params": layers}


def drop_action(params: Any, index: int) -> Any:
    """Return the parameters of a policy for actions [a - 1]: `params`, leaves [..., ...], without component `index`."""
    layers = dict(params["params"])
    last = f"hidden_{len(layers) - 1}"
    size = layers[last]["bias"].shape[-1] // 2
    dropped = jnp.array([index, size + index])
    layers[last] = {
        name: jnp.delete(leaf, dropped, axis=-1, assume_unique_indices=True) for name, leaf in layers[last].items()
    }
    return {"params": layers}


def check_precision(precision: str) -> None:
    """Raise a ValueError if `precision` is not one of `PRECISIONS`."""
    if precision not in PRECISIONS:
        raise InputError(f"precision {precision!r} is not one of {', '.join(PRECISIONS)}")


def apply(network: networks.MLP, params: Any, x: jax.Array, precision: str = "tf32") -> jax.Array:
    """Return the float32 outputs [..., O] of `network` at `x [..., K]`, differentiable in `params` and `x`.

    Matrix products by `precision`: "float32" is float32 on every device; "tf32" is XLA's default (TF32 on NVIDIA GPUs,
    float32 on CPUs); "bf16" has bfloat16 operands and activations and float32 sums.
    """
    if precision == "bf16":
        return bf16.apply(network, params["params"], x.reshape(-1, x.shape[-1])).reshape(*x.shape[:-1], -1)
    with jax.default_matmul_precision("highest") if precision == "float32" else contextlib.nullcontext():
        return jnp.asarray(network.apply(params, x))
