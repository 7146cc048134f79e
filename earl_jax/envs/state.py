"""What an environment returns: its state, what a step leads to, and where scripted demonstrations start."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax.core import Tracer

NextState = tuple[Any, jax.Array, dict[str, jax.Array]]
"""What a control step leads to: the physics data, the state vector [s], and the fields of `info` that changed."""


class State(struct.PyTreeNode):
    """The state of an environment: physics `data`, `obs [s + g]`, scalar float32 `reward` and `done`, `metrics`, `info`.

    The tree keeps its structure, dtypes and weak types from `reset` on, so it can be a scan's carry.
    """

    data: Any
    obs: jax.Array
    reward: jax.Array
    done: jax.Array
    metrics: dict[str, jax.Array]
    info: dict[str, jax.Array]


class DemoStart(NamedTuple):
    """Where a pair of scripted demonstrations starts.

    `forward` is the start of the forward demonstration. `backward` is that of the backward one; None starts it where the
    forward one ended. `backward_goal [g]` is its goal; None records no backward demonstration.
    """

    forward: State
    backward: State | None
    backward_goal: np.ndarray | None


def tree_where(condition: jax.Array, tree: Any, other: Any) -> Any:
    """Return `tree` where `condition`, bool [], is true, else `other`, a tree of the same structure."""
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), tree, other)


def check_action(action: jax.Array, size: int) -> None:
    """Raise a ValueError if `action` has another shape than [size], or is known not to be finite."""
    shape = jnp.shape(action)
    if shape != (size,):
        raise ValueError(f"action has shape {shape}, this task takes ({size},); for a batch of lanes use jax.vmap")
    if not isinstance(action, Tracer) and not np.isfinite(np.asarray(action)).all():
        raise ValueError(f"action is not finite: {np.asarray(action).tolist()}")
