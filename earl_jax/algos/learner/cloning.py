"""Behaviour cloning of an actor: a regression of the greedy action on demonstrated actions.

`clone` trains an actor before any interaction; `cloning_term` is the same error as a term of the actor's loss.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.algos.learner.base import Batch, Learner
from earl_jax.algos.learner.networks import ADAM, descend


class DemoSteps(NamedTuple):
    """Demonstrated steps: `obs [T, o]` with the goal, `action [T, a]`, and the `controller [T]` that clones them."""

    obs: np.ndarray | jax.Array
    action: np.ndarray | jax.Array
    controller: np.ndarray | jax.Array

    def of(self, controller: int) -> "DemoSteps":
        """Return the steps of `controller`, or all of them if it has none of its own."""
        own = self.controller == controller
        return DemoSteps(*[field[own] for field in self]) if own.any() else self


def clone(key: jax.Array, learner: Learner, actors: Any, demos: DemoSteps) -> tuple[Any, jax.Array]:
    """Return the cloned `actors`, leaves [C, ...], and their losses [C, pretrain_steps].

    Every actor makes `pretrain_steps` Adam steps of size `pretrain_rate` on `mean (pi(s, g) - a)^2`, each on
    `batch_size` steps that are drawn uniformly with replacement from its own demonstrations.
    """
    count = len(jax.tree.leaves(actors)[0])
    parts = [
        _clone_actor(own_key, learner, jax.tree.map(lambda leaf, c=c: leaf[c], actors), demos.of(c))
        for c, own_key in enumerate(jax.random.split(key, count))
    ]
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *parts)


def _clone_actor(key: jax.Array, learner: Learner, actor: Any, demos: DemoSteps) -> tuple[Any, jax.Array]:
    """Return one cloned `actor` and its losses [pretrain_steps]."""
    obs, action = jnp.asarray(demos.obs), jnp.asarray(demos.action)

    def step(carry, step_key):
        actor, moments = carry
        rows = jax.random.randint(step_key, (learner.batch_size,), 0, len(obs))
        loss, grads = jax.value_and_grad(cloning_loss)(actor, learner, obs[rows], action[rows])
        return descend(actor, grads, moments, learner.pretrain_rate), loss

    keys = jax.random.split(key, learner.pretrain_steps)
    (actor, _), losses = jax.lax.scan(step, (actor, ADAM.init(actor)), keys)
    return actor, losses


def cloning_loss(actor: Any, learner: Learner, obs: jax.Array, action: jax.Array) -> jax.Array:
    """Return the mean squared error [] between the greedy action at `obs [B, o]` and `action [B, a]`."""
    return jnp.square(learner.greedy(actor, obs) - action).mean()


def cloning_weight(learner: Learner, step: jax.Array) -> jax.Array:
    """Return the weight [] of the cloning term at `step`, linear from `cloning` to `cloning_final` if that is given."""
    progress = jnp.clip((step - learner.cloning_start) / learner.cloning_steps, 0.0, 1.0)
    first = 0.0 if learner.cloning is None else learner.cloning
    final = first if learner.cloning_final is None else learner.cloning_final
    return first + (final - first) * progress


def cloning_term(learner: Learner, greedy: jax.Array, batch: Batch) -> jax.Array:
    """Return `w lambda mean (pi(s, g) - a)^2` [] over the demonstrated rows of `batch`, a term of the actor's loss.

    `greedy [B, a]` are the greedy actions pi(s, g); w is `cloning_weight`, lambda `Learner.reward_scale`. Without
    demonstrated rows the term is 0. Source: Rajeswaran et al. 2018 (DAPG) and MEDAL++ add a log-likelihood term. This
    term is the squared error of `clone` instead, which leaves the entropy to SAC.
    """
    assert batch.demonstrated is not None
    assert batch.step is not None
    errors = jnp.square(greedy - batch.action).mean(axis=-1)
    count = jnp.maximum(batch.demonstrated.sum(), 1)
    mean = jnp.where(batch.demonstrated, errors, 0.0).sum() / count
    return cloning_weight(learner, batch.step) * learner.reward_scale * mean
