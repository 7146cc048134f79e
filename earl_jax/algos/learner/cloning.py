"""Behaviour cloning of an actor: a regression of the policy's mode on demonstrated actions, before any interaction."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.algos.learner import sac as sac_lib
from earl_jax.algos.learner.sac import SAC


class Demonstrations(NamedTuple):
    """Demonstrated steps: `obs [T, o]` with the goal, `action [T, a]`, and the `controller [T]` that takes them."""

    obs: np.ndarray
    action: np.ndarray
    controller: np.ndarray

    def of(self, controller: int) -> "Demonstrations":
        """Return the steps of `controller`, or all of them if it has none of its own."""
        own = self.controller == controller
        return Demonstrations(*[field[own] for field in self]) if own.any() else self


def clone(key: jax.Array, sac: SAC, actors: Any, demos: Demonstrations, steps: int, rate: Any) -> tuple[Any, jax.Array]:
    """Return cloned `actors`, leaves [C, ...], and their losses [C, steps].

    Every actor takes `steps` Adam steps of size `rate` on `mean (tanh mu(s, g) - a)^2`, each on `sac.batch_size` steps
    of its own demonstrations, drawn uniformly with replacement.
    """
    count = len(jax.tree.leaves(actors)[0])
    parts = [
        _clone_actor(controller_key, sac, jax.tree.map(lambda leaf, c=c: leaf[c], actors), demos.of(c), steps, rate)
        for c, controller_key in enumerate(jax.random.split(key, count))
    ]
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *parts)


def _clone_actor(
    key: jax.Array, sac: SAC, actor: Any, demos: Demonstrations, steps: int, rate: Any
) -> tuple[Any, jax.Array]:
    """Return one cloned `actor` and its losses [steps]."""
    obs, action = jnp.asarray(demos.obs), jnp.asarray(demos.action)

    def step(carry, step_key):
        actor, moments = carry
        rows = jax.random.randint(step_key, (sac.batch_size,), 0, len(obs))
        loss, grads = jax.value_and_grad(cloning_loss)(actor, sac, obs[rows], action[rows])
        return sac_lib.descend(actor, grads, moments, rate), loss

    (actor, _), losses = jax.lax.scan(step, (actor, sac_lib.ADAM.init(actor)), jax.random.split(key, steps))
    return actor, losses


def cloning_loss(actor: Any, sac: SAC, obs: jax.Array, action: jax.Array) -> jax.Array:
    """Return the mean squared error [] of the policy's mode at `obs [B, o]` to `action [B, a]`."""
    return jnp.square(sac_lib.greedy(sac, actor, obs, action.shape[-1]) - action).mean()
