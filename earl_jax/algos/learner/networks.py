"""The learner's networks: a multilayer perceptron and a tanh-squashed normal, with the paper's parameters.

`apply` evaluates a network at a chosen precision; parameters are always float32. They are those of Brax's networks, which
earlier versions used; Brax imports MuJoCo MJX, which takes a third of the time in which a process starts.
"""

import contextlib
import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
from flax import linen

from earl_jax.algos.learner import bf16
from earl_jax.errors import InputError

LOG_STD_RANGE = (-20.0, 2.0)
PRECISIONS = ("float32", "tf32", "bf16")


@dataclasses.dataclass(frozen=True)
class TanhNormal:
    """Tanh-squashed normal of `size` actions; the clipped output of the network is its log standard deviation.

    Every method takes `parameters [..., 2a]`: the means, then the log standard deviations, as in the paper.
    """

    size: int

    def sample(self, parameters: jax.Array, key: jax.Array) -> jax.Array:
        """Return actions [..., a]."""
        return jnp.tanh(self.sample_raw(parameters, key))

    def sample_raw(self, parameters: jax.Array, key: jax.Array) -> jax.Array:
        """Return actions [..., a] before squashing, reparametrised."""
        mean, std = self._moments(parameters)
        return jax.random.normal(key, mean.shape) * std + mean

    def mode(self, parameters: jax.Array) -> jax.Array:
        """Return the squashed means [..., a]."""
        return jnp.tanh(self._moments(parameters)[0])

    def log_prob(self, parameters: jax.Array, raw: jax.Array) -> jax.Array:
        """Return the log-densities [...] of the actions tanh(`raw [..., a]`) (appendix C of the SAC paper)."""
        mean, std = self._moments(parameters)
        normal = -0.5 * jnp.square(raw / std - mean / std) - (0.5 * jnp.log(2.0 * jnp.pi) + jnp.log(std))
        return (normal - 2.0 * (jnp.log(2.0) - raw - jax.nn.softplus(-2.0 * raw))).sum(axis=-1)

    def _moments(self, parameters: jax.Array) -> tuple[jax.Array, jax.Array]:
        mean, log_std = jnp.split(parameters, [self.size], axis=-1)
        return mean, jnp.exp(jnp.clip(log_std, *LOG_STD_RANGE))


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


def mlp(hidden_sizes: tuple[int, ...], outputs: int, layer_norm: bool = False) -> MLP:
    """Return the `MLP` with the layers `hidden_sizes` and `outputs`."""
    return MLP((*hidden_sizes, outputs), layer_norm)


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


def apply(network: MLP, params: Any, x: jax.Array, precision: str = "tf32") -> jax.Array:
    """Return the float32 outputs [..., O] of `network` at `x [..., K]`, differentiable in `params` and `x`.

    Matrix products by `precision`: "float32" is float32 on every device; "tf32" is XLA's default (TF32 on NVIDIA GPUs,
    float32 on CPUs); "bf16" has bfloat16 operands and activations and float32 sums.
    """
    if precision == "bf16":
        return bf16.apply(network, params["params"], x.reshape(-1, x.shape[-1])).reshape(*x.shape[:-1], -1)
    with jax.default_matmul_precision("highest") if precision == "float32" else contextlib.nullcontext():
        return jnp.asarray(network.apply(params, x))
