"""Behaviour cloning of an actor: a regression of the policy's mode on demonstrated actions.

`clone` takes it before any interaction, and `cloning_term` is the same error as a term of the actor's loss.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.algos.learner import networks
from earl_jax.algos.learner import sac as sac_lib
from earl_jax.algos.learner.sac import SAC, Agent, Batch


class Demonstrations(NamedTuple):
    """Demonstrated steps: `obs [T, o]` with the goal, `action [T, a]`, and the `controller [T]` that takes them."""

    obs: np.ndarray | jax.Array
    action: np.ndarray | jax.Array
    controller: np.ndarray | jax.Array

    def of(self, controller: int) -> "Demonstrations":
        """Return the steps of `controller`, or all of them if it has none of its own."""
        own = self.controller == controller
        return Demonstrations(*[field[own] for field in self]) if own.any() else self


def pretrained(key: jax.Array, sac: SAC, agent: Agent, demos: Demonstrations) -> Agent:
    """Return `agent` (leading controller axis) with actors cloned in `SAC.pretrain_steps`, and their log-std set."""
    actor, _ = clone(key, sac, agent.actor, demos, sac.pretrain_steps, sac.pretrain_rate)
    return agent.with_actor(
        actor if sac.pretrain_log_std is None else networks.fix_log_std(actor, sac.pretrain_log_std)
    )


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


def cloning_weight(sac: SAC, step: jax.Array) -> jax.Array:
    """Return the weight [] of the cloning term at `step`: linear from `cloning` to `cloning_final`, if that is given."""
    progress = jnp.clip((step - sac.cloning_start) / sac.cloning_steps, 0.0, 1.0)
    first = 0.0 if sac.cloning is None else sac.cloning
    final = first if sac.cloning_final is None else sac.cloning_final
    return first + (final - first) * progress


def cloning_term(sac: SAC, parameters: jax.Array, batch: Batch) -> jax.Array | None:
    """Return `w lambda mean (tanh mu - a)^2` over the demonstrated rows of `batch`, a term of the actor's loss.

    `parameters [B, 2a]` are the policy's; w is `cloning_weight`, lambda `SAC.reward_scale`. Without demonstrated rows it
    is 0, without `SAC.cloning` None. Source: Rajeswaran et al. 2018 (DAPG) and MEDAL++ add such a term, on the
    log-likelihood; here it is the squared error of `clone`, which leaves the entropy to SAC.
    """
    if sac.cloning is None:
        return None
    assert batch.demonstrated is not None
    assert batch.step is not None
    errors = jnp.square(networks.TanhNormal(batch.action.shape[-1]).mode(parameters) - batch.action).mean(axis=-1)
    count = jnp.maximum(batch.demonstrated.sum(), 1)
    mean = jnp.where(batch.demonstrated, errors, 0.0).sum() / count
    return cloning_weight(sac, batch.step) * sac.reward_scale * mean
