"""A variant of R3L for difference 12, with `--import benchmarks/paper/r3l_variants.py`."""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp

import earl_jax
from earl_jax.algos.r3l import R3L, RND

OBJECT = slice(2, 4)
"""The position of tabletop's mug in its state."""


class R3LObjectNovelty(R3L):
    """R3L whose novelty is that of the mug's position alone, on tabletop."""

    name: ClassVar[str] = "r3l_object_novelty"

    def prepare(self, key, env, goals, batch, phase, method_state: RND) -> Any:
        prepared = super().prepare(key, env, goals, batch._replace(state=_object(batch.state)), phase, method_state)
        return prepared._replace(state=batch.state)

    def distil(self, rnd: RND, states: jax.Array) -> RND:
        return super().distil(rnd, _object(states))


def _object(states: jax.Array) -> jax.Array:
    """Return `states [B, s]` with zeros but for the object's position."""
    return jnp.zeros_like(states).at[:, OBJECT].set(states[:, OBJECT])


earl_jax.register_algo(R3LObjectNovelty.name, R3LObjectNovelty)
