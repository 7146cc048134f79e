"""Soft actor-critic, the learner of all methods: a gradient step on the critics, the actor and the temperature.

Source: Haarnoja et al. 2018 (arXiv 1812.05905). The options of ensembles and of several critic updates a step are those
of Chen et al. 2021 (REDQ) and Ball et al. 2023 (RLPD). `hyperparameters` names the source of each value.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from flax import struct

from earl_jax.algos.learner import networks
from earl_jax.algos.learner.hyperparameters import SAC, SOFT_CRITICS
from earl_jax.algos.learner.networks import TanhNormal, mlp

DIAGNOSTICS: tuple[str, ...] = ("critic_loss", "entropy", "temperature")


class Batch(NamedTuple):
    """Transitions to learn from: `obs, next_obs [B, o]`, `action [B, a]`, `reward [B]`, bool `terminal [B]`.

    `demonstrated [B]`, bool, marks demonstrations of what the controller is to do, and `step []` is that of the lifetime;
    terms of the actor's loss read both. With B = `utd` batches, the critics learn from each in turn.
    """

    obs: jax.Array
    action: jax.Array
    reward: jax.Array
    terminal: jax.Array
    next_obs: jax.Array
    demonstrated: jax.Array | None = None
    step: jax.Array | None = None


ActorTerm = Callable[[jax.Array, Batch], jax.Array | None]
"""A term [] of the actor's loss, from the parameters [B, 2a] of the policy at a batch; None: no term."""


class Agent(struct.PyTreeNode):
    """One controller: actor, K stacked critics and their targets, log temperature, Adam's moments, averaged actor.

    The first `SAC.ensemble` critics are SAC's. Further critics are pairs trained without the entropy term, for methods
    that interpret values as success probabilities.
    """

    actor: Any
    critics: Any
    targets: Any
    log_temperature: jax.Array
    moments: dict[str, Any]
    averaged: Any = None
    """Moving average of the actor's weights; None without `SAC.actor_average_rate`."""

    @property
    def deployed_actor(self) -> Any:
        """The actor of evaluations and saved policies: the average, where there is one."""
        return self.actor if self.averaged is None else self.averaged

    def with_actor(self, actor: Any) -> "Agent":
        """Return the agent with another actor, from which the average starts again."""
        return self.replace(actor=actor, averaged=None if self.averaged is None else actor)


ADAM = optax.scale_by_adam()


def _critic(sac: SAC) -> Any:
    return mlp(sac.hidden_sizes, 1, sac.layer_norm)


def _policy(sac: SAC, actor: Any, obs: jax.Array, action_size: int) -> jax.Array:
    """Return the parameters [..., 2a] of the action distribution at `obs [..., o]`."""
    return networks.apply(mlp(sac.hidden_sizes, 2 * action_size), actor, obs, sac.precision)


def critic_count(sac: SAC, critics: int) -> int:
    """Return the number K of stacked critics of a method with `critics` >= 2, of which the first two are the ensemble."""
    return sac.ensemble + critics - SOFT_CRITICS


def critics_without_entropy(sac: SAC, agent: Agent) -> Any:
    """Return the stacked critics of a single controller that are trained without the entropy term, for `q_values`."""
    return jax.tree.map(lambda leaf: leaf[sac.ensemble :], agent.critics)


def init(key: jax.Array, sac: SAC, obs_size: int, action_size: int, critics: int = SOFT_CRITICS) -> Agent:
    """Return a fresh `Agent` for observations [o] and actions [a] with the critics of `critic_count`."""
    actor_key, critic_key = jax.random.split(key)
    actor = mlp(sac.hidden_sizes, 2 * action_size).init(actor_key, jnp.zeros((obs_size,)))
    example = jnp.zeros((obs_size + action_size,))
    critic = jax.vmap(_critic(sac).init, (0, None))(jax.random.split(critic_key, critic_count(sac, critics)), example)
    log_temperature = jnp.log(jnp.asarray(sac.initial_temperature, jnp.float32))
    moments = {
        "actor": ADAM.init(actor),
        "critics": ADAM.init(critic),
        "temperature": ADAM.init(log_temperature),
    }
    averaged = None if sac.actor_average_rate is None else jax.tree.map(jnp.copy, actor)
    return Agent(actor, critic, jax.tree.map(jnp.copy, critic), log_temperature, moments, averaged)


def act(sac: SAC, actor: Any, obs: jax.Array, key: jax.Array, action_size: int) -> jax.Array:
    """Return actions [..., a] sampled from the policy at `obs [..., o]`."""
    return TanhNormal(action_size).sample(_policy(sac, actor, obs, action_size), key)


def greedy(sac: SAC, actor: Any, obs: jax.Array, action_size: int) -> jax.Array:
    """Return the policy's mode [..., a] at `obs [..., o]`, the action in evaluations."""
    return TanhNormal(action_size).mode(_policy(sac, actor, obs, action_size))


def act_with_log_prob(sac: SAC, actor: Any, obs: jax.Array, key: jax.Array, size: int) -> tuple[jax.Array, jax.Array]:
    """Return reparametrised actions [..., a] and their log-probabilities [...] (appendix C of the SAC paper)."""
    return _sample(_policy(sac, actor, obs, size), key, size)


def _sample(parameters: jax.Array, key: jax.Array, size: int) -> tuple[jax.Array, jax.Array]:
    """Return actions and log-probabilities of the policy's `parameters [..., 2a]`, as `act_with_log_prob`."""
    policy = TanhNormal(size)
    raw = policy.sample_raw(parameters, key)
    return jnp.tanh(raw), policy.log_prob(parameters, raw)


def q_values(sac: SAC, critics: Any, obs: jax.Array, action: jax.Array) -> jax.Array:
    """Return the values [K, ...] of K stacked critics at `obs [..., o]` and `action [..., a]`."""
    pair = jnp.concatenate([obs, action], axis=-1)
    critic, axis = functools.partial(networks.apply, _critic(sac), precision=sac.precision), None
    if sac.precision == "bf16":  # repeated for every critic, so that all products of the stack have one batch axis
        pair, axis = jnp.broadcast_to(pair, (jax.tree.leaves(critics)[0].shape[0], *pair.shape)), 0
    return jax.vmap(critic, (0, axis))(critics, pair)[..., 0]


def _pair_min(values: jax.Array) -> jax.Array:
    """Return each critic's clipped double-Q value: the minimum over its pair, [K, ...] -> [K, ...]."""
    pairs = values.reshape(-1, 2, *values.shape[1:]).min(axis=1)
    return jnp.repeat(pairs, 2, axis=0)


def _next_values(sac: SAC, targets: Any, obs: jax.Array, action: jax.Array, key: jax.Array) -> jax.Array:
    """Return the value [K, B] of the next step for each critic, by the `targets` of its pair or of a random subset."""
    if sac.ensemble == sac.target_subset == SOFT_CRITICS:
        return _pair_min(q_values(sac, targets, obs, action))
    chosen = jax.random.permutation(jax.random.fold_in(key, 1), sac.ensemble)[: sac.target_subset]
    kept = jax.tree.map(lambda leaf: jnp.concatenate([leaf[chosen], leaf[sac.ensemble :]]), targets)
    values = q_values(sac, kept, obs, action)
    lowest = values[: sac.target_subset].min(axis=0)
    own = jnp.broadcast_to(lowest, (sac.ensemble, *lowest.shape))
    return jnp.concatenate([own, _pair_min(values[sac.target_subset :])])


def td_target(sac: SAC, agent: Agent, batch: Batch, key: jax.Array) -> jax.Array:
    """Return the regression targets [K, B]: `scale r + (1 - terminal) gamma (min Q'(s', a') - alpha log pi(a'|s'))`.

    At a terminal transition, time-outs included, the target is the scaled reward alone: the biased TD update of the
    EARL paper, section 5.1. The minimum is over a random `target_subset` of the ensemble (Chen et al. 2021, REDQ,
    algorithm 1). Without `backup_entropy`, and for critics after the ensemble, there is no entropy term.
    """
    next_action, log_prob = act_with_log_prob(sac, agent.actor, batch.next_obs, key, batch.action.shape[-1])
    values = _next_values(sac, agent.targets, batch.next_obs, next_action, key)
    if sac.backup_entropy:
        soft = (jnp.arange(values.shape[0]) < sac.ensemble)[:, None]
        values = values - soft * jnp.exp(agent.log_temperature) * log_prob
    return sac.reward_scale * batch.reward + jnp.where(batch.terminal, 0.0, sac.discount * values)


def descend(params: Any, grads: Any, moments: Any, rate: float) -> tuple[Any, Any]:
    """Return parameters and Adam moments after one descent step of size `rate` along `grads`."""
    direction, moments = ADAM.update(grads, moments)
    return jax.tree.map(lambda p, d: p - rate * d, params, direction), moments


def _update_critics(sac: SAC, agent: Agent, batch: Batch, key: jax.Array) -> tuple[Agent, jax.Array]:
    target = jax.lax.stop_gradient(td_target(sac, agent, batch, key))

    def loss(critics):
        errors = q_values(sac, critics, batch.obs, batch.action) - target
        return 0.5 * jnp.square(errors).mean(axis=1).sum()

    value, grads = jax.value_and_grad(loss)(agent.critics)
    critics, moments = descend(agent.critics, grads, agent.moments["critics"], sac.learning_rate)
    return agent.replace(critics=critics, moments={**agent.moments, "critics": moments}), value


def _update_actor(
    sac: SAC, agent: Agent, batch: Batch, key: jax.Array, actor_term: ActorTerm | None
) -> tuple[Agent, jax.Array]:
    """Return the agent after a descent step on `alpha log pi - min Q` and `actor_term`, and the mean log-probability.

    An ensemble of more than two has its mean in the place of the minimum.
    """
    temperature = jnp.exp(agent.log_temperature)
    soft = jax.tree.map(lambda leaf: leaf[: sac.ensemble], agent.critics)

    def loss(actor):
        parameters = _policy(sac, actor, batch.obs, batch.action.shape[-1])
        action, log_prob = _sample(parameters, key, batch.action.shape[-1])
        values = q_values(sac, soft, batch.obs, action)
        value = values.min(axis=0) if sac.ensemble == SOFT_CRITICS else values.mean(axis=0)
        total = (temperature * log_prob - value).mean()
        term = None if actor_term is None else actor_term(parameters, batch)
        return total if term is None else total + term, log_prob.mean()

    grads, log_prob = jax.grad(loss, has_aux=True)(agent.actor)
    actor, moments = descend(agent.actor, grads, agent.moments["actor"], sac.learning_rate)
    return agent.replace(actor=actor, moments={**agent.moments, "actor": moments}), log_prob


def _update_temperature(sac: SAC, agent: Agent, log_prob: jax.Array, action_size: int) -> Agent:
    """Return the agent after a descent step on `-log alpha (log pi + target entropy)`, the released code's loss.

    With `fixed_temperature` the agent is returned as it is.
    """
    if sac.fixed_temperature:
        return agent
    grad = -(log_prob + sac.entropy_per_action * action_size)
    value, moments = descend(agent.log_temperature, grad, agent.moments["temperature"], sac.learning_rate)
    return agent.replace(log_temperature=value, moments={**agent.moments, "temperature": moments})


def _update_targets(sac: SAC, agent: Agent) -> Agent:
    return agent.replace(targets=_follow(agent.targets, agent.critics, sac.target_rate))


def _update_average(sac: SAC, agent: Agent) -> Agent:
    """Return the agent with its averaged actor a step nearer to the actor, if it has one (Nikishin et al. 2018)."""
    if sac.actor_average_rate is None:
        return agent
    return agent.replace(averaged=_follow(agent.averaged, agent.actor, sac.actor_average_rate))


def _follow(slow: Any, fast: Any, rate: Any) -> Any:
    return jax.tree.map(lambda old, new: old + rate * (new - old), slow, fast)


def _repeat_critic_updates(sac: SAC, agent: Agent, batch: Batch, key: jax.Array) -> tuple[Agent, Batch]:
    """Return the agent after critic updates on all but the last of `utd` batches, and the last one."""
    parts = jax.tree.map(lambda leaf: leaf.reshape(sac.utd, -1, *leaf.shape[1:]), batch._replace(step=None))

    def step(agent, part):
        agent, _ = _update_critics(sac, agent, part[0], part[1])
        return _update_targets(sac, agent), None

    earlier, keys = jax.tree.map(lambda leaf: leaf[:-1], parts), jax.random.split(key, sac.utd - 1)
    agent, _ = jax.lax.scan(step, agent, (earlier, keys))
    return agent, jax.tree.map(lambda leaf: leaf[-1], parts)._replace(step=batch.step)


def without_update(agent: Agent) -> tuple[Agent, dict[str, jax.Array]]:
    """Return `agent` as it is and diagnostics of 0, what `update` is to a method that does not learn."""
    return agent, dict.fromkeys(DIAGNOSTICS, jnp.zeros(()))


def update(
    sac: SAC, agent: Agent, batch: Batch, key: jax.Array, actor_term: ActorTerm | None = None
) -> tuple[Agent, dict[str, jax.Array]]:
    """Return the agent after a step on critics, actor (with the updated critics) and temperature, and diagnostics.

    With `utd` batches in one, the critics and their targets take a step on each, the actor one on the last. `actor_term`
    is added to the actor's loss. Targets and the averaged actor follow at the end.
    """
    if sac.utd > 1:
        agent, batch = _repeat_critic_updates(sac, agent, batch, jax.random.fold_in(key, 1))
    critic_key, actor_key = jax.random.split(key)
    agent, critic_loss = _update_critics(sac, agent, batch, critic_key)
    agent, log_prob = _update_actor(sac, agent, batch, actor_key, actor_term)
    agent = _update_temperature(sac, agent, log_prob, batch.action.shape[-1])
    diagnostics = critic_loss, -log_prob, jnp.exp(agent.log_temperature)
    agent = _update_average(sac, _update_targets(sac, agent))
    return agent, dict(zip(DIAGNOSTICS, diagnostics, strict=True))
