"""The return types of an environment: its state and the result of a step, with helpers for trees and keys."""

import dataclasses
import functools
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from earl_jax.errors import brief

NextState = tuple[Any, jax.Array, dict[str, jax.Array]]
"""The result of a control step: the physics data, the state vector [s], and the changed fields of `info`."""


MOST_ARRAYS = 4
"""Largest number of arrays in a field that `struct_text` names one by one."""


def struct_text(self: Any) -> str:
    """Return the `__repr__` of a flax struct of arrays or tracers: a line for each field with types and shapes."""
    fields = [f"  {field.name}: {_tree_text(getattr(self, field.name))}\n" for field in dataclasses.fields(self)]
    return f"{type(self).__name__}(\n{''.join(fields)})"


def _tree_text(tree: Any) -> str:
    leaves = jax.tree_util.tree_leaves_with_path(tree)
    if not leaves or len(leaves) > MOST_ARRAYS:
        return f"{type(tree).__name__} of {len(leaves)} arrays" if leaves else brief(tree)
    names = [jax.tree_util.keystr(path, simple=True, separator=".") for path, _ in leaves]
    texts = [f"{leaf.dtype}{list(leaf.shape)}" if hasattr(leaf, "dtype") else brief(leaf) for _, leaf in leaves]
    return ", ".join(f"{name} {text}".lstrip() for name, text in zip(names, texts, strict=True))


class State(struct.PyTreeNode):
    """The state of an environment: physics `data`, `obs [s + g]`, float32 `reward` and `done` [], `metrics`, `info`.

    `metrics["success"]` is 1 at the goal and 0 elsewhere, and `info["goal"]` is the goal [g]; a task can add further
    entries. The tree keeps its structure, dtypes and weak types from `reset` on, so a scan can carry it.
    """

    data: Any
    obs: jax.Array
    reward: jax.Array
    done: jax.Array
    metrics: dict[str, jax.Array]
    info: dict[str, jax.Array]

    __repr__ = struct_text


def tree_where(condition: jax.Array | bool, tree: Any, other: Any) -> Any:
    """Return `tree` where `condition`, bool [], is true, else `other`, a tree of the same structure."""
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), tree, other)


def random_row(key: jax.Array, table: Any) -> Any:
    """Return one row of `table`, a tree of arrays [n, ...], drawn uniformly."""
    index = jax.random.randint(key, (), 0, len(jax.tree.leaves(table)[0]))
    return jax.tree.map(lambda values: jnp.asarray(values)[index], table)


def stored_key(key: jax.Array) -> jax.Array:
    """Return the data of `key` for `wrap_key_data`; a key of another kind is converted to jax's default kind."""
    data, default = jax.random.key_data(key), jax.random.key_data(jax.random.key(0))
    return data if data.shape == default.shape else jax.random.bits(key, default.shape, default.dtype)


def all_finite(tree: Any) -> jax.Array:
    """Return whether every floating-point number in `tree` is finite, bool []."""
    leaves = [leaf for leaf in jax.tree.leaves(tree) if jnp.issubdtype(leaf.dtype, jnp.inexact)]
    return functools.reduce(jnp.logical_and, [jnp.isfinite(leaf).all() for leaf in leaves], jnp.ones((), bool))
