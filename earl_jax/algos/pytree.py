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

    It is a `flax.struct.PyTreeNode` whose structure has its class as well. The structures of two classes of flax with equal
    fields are equal but have different hashes (jaxlib 0.10.2), so that `jax.jit` now and then runs the program of the other
    class: that of naive RL for a subclass, or that of a class which a notebook has defined again since.
    """

    def __init_subclass__(cls, **options: Any):
        super().__init_subclass__()
        check_overrides(cls)
        dataclasses.dataclass(frozen=True, **options)(cls)

        def names() -> tuple[list[str], list[str]]:
            """Return the fields that are leaves and the others, to which `%autoreload` may have added some."""
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
        """Return a copy with other values of some fields."""
        return dataclasses.replace(self, **changes)


def _leaf(value: Any) -> Any:
    """Return a list of a number for each lane as an array, since jax takes a list apart; other values as they are."""
    return np.asarray(value) if isinstance(value, list) and all(map(np.isscalar, value)) else value
