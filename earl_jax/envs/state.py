"""The return types of an environment: its state and the result of a step."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax.core import Tracer

from earl_jax.errors import InputError

NextState = tuple[Any, jax.Array, dict[str, jax.Array]]
"""The result of a control step: the physics data, the state vector [s], and the changed fields of `info`."""


class State(struct.PyTreeNode):
    """The state of an environment: physics `data`, `obs [s + g]`, float32 `reward` and `done` [], `metrics`, `info`.

    The tree keeps its structure, dtypes and weak types from `reset` on, so it can be the carry of a scan.
    """

    data: Any
    obs: jax.Array
    reward: jax.Array
    done: jax.Array
    metrics: dict[str, jax.Array]
    info: dict[str, jax.Array]


def tree_where(condition: jax.Array, tree: Any, other: Any) -> Any:
    """Return `tree` where `condition`, bool [], is true, else `other`, a tree of the same structure."""
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), tree, other)


def check_action(action: jax.Array, size: int) -> None:
    """Raise a ValueError if `action` does not have the shape [size], or is known not to be finite."""
    shape = jnp.shape(action)
    if shape != (size,):
        raise InputError(f"action has shape {shape}, this task takes ({size},); for a batch of lanes use jax.vmap")
    if not isinstance(action, Tracer) and not np.isfinite(np.asarray(action)).all():
        raise InputError(f"action is not finite: {np.asarray(action).tolist()}")


def all_finite(tree: Any) -> jax.Array:
    """Return whether every floating-point number in `tree` is finite, bool []."""
    leaves = [leaf for leaf in jax.tree.leaves(tree) if jnp.issubdtype(leaf.dtype, jnp.inexact)]
    return jnp.stack([jnp.isfinite(leaf).all() for leaf in leaves]).all()
