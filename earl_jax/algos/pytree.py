"""The base class of methods and learners: dataclasses of options that are pytrees."""

import dataclasses
from typing import Any, Self, dataclass_transform

import jax
import numpy as np
from flax import struct

from earl_jax.errors import check_overrides


@dataclass_transform(field_specifiers=(struct.field,), frozen_default=True)
@dataclasses.dataclass(frozen=True)
class OptionsNode:
    """A frozen dataclass that is a pytree. Fields of `flax.struct.field(pytree_node=False)` belong to its structure.

    It is a `flax.struct.PyTreeNode` whose structure also contains its class. In flax, the structures of two classes
    with equal fields are equal but have different hashes (jaxlib 0.10.2). `jax.jit` therefore sometimes runs the
    program of the wrong class: naive RL's for a subclass, or that of a class that a notebook has since redefined.
    """

    def __init_subclass__(cls, **options: Any):
        super().__init_subclass__()
        check_overrides(cls)
        dataclasses.dataclass(frozen=True, **options)(cls)

        def names() -> tuple[list[str], list[str]]:
            """Return the names of leaf fields and of static fields, including fields that `%autoreload` has added."""
            fields = dataclasses.fields(cls)
            leaves = [field.name for field in fields if field.metadata.get("pytree_node", True)]
            return leaves, [field.name for field in fields if field.name not in leaves]

        def flatten(node: Any) -> tuple[list, tuple]:
            leaves, static = names()
            keyed = [(jax.tree_util.GetAttrKey(name), _leaf(getattr(node, name))) for name in leaves]
            return keyed, tuple(getattr(node, name) for name in static)

        def unflatten(values: tuple, children: Any) -> Any:
            leaves, static = names()
            return cls(**dict(zip(leaves + static, (*children, *values), strict=True)))

        jax.tree_util.register_pytree_with_keys(cls, flatten, unflatten)

    def replace(self, **changes: Any) -> Self:
        """Return a copy with the fields in `changes` replaced."""
        return dataclasses.replace(self, **changes)


def _leaf(value: Any) -> Any:
    """Return a list with a number for each lane as an array, because jax would flatten a list; keep other values."""
    return np.asarray(value) if isinstance(value, list) and all(map(np.isscalar, value)) else value
