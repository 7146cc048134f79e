"""Soft actor-critic: a gradient step on the critics, the actor and the temperature.

Source: Haarnoja et al. 2018 (arXiv 1812.05905). The options for ensembles and several critic updates per step are from
Chen et al. 2021 (REDQ) and Ball et al. 2023 (RLPD). Defaults that Sharma et al. 2022, appendix, do not give follow the
authors' released TF-Agents code; each field names its source.
"""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from flax import struct

from earl_jax.algos.learner import networks
from earl_jax.algos.learner.base import Batch, Learner
from earl_jax.algos.learner.cloning import cloning_term
from earl_jax.algos.learner.networks import ADAM, MLP, descend, follow
from earl_jax.errors import InputError
from earl_jax.options.values import within

SOFT_CRITICS = 2
"""The paper's number of critics with the entropy term."""


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


class SAC(Learner):
    """Maximise the minimum of two critics plus the policy's entropy, with a learnt temperature; the default learner.

    Source: Haarnoja et al. 2018, "Soft Actor-Critic Algorithms and Applications", with the hyper-parameters of Sharma et
    al. 2022.
    """

    target_rate: float = struct.field(default=0.005, metadata=within("(0, 1]"))
    """tau of the target critics, which are updated every step (paper)."""
    actor_average_rate: float | None = struct.field(default=None, metadata=within("(0, 1]"))
    """Rate of an exponential moving average of the actor's weights, updated every step. Evaluations and saved policies
    use the average; the actor itself acts in the lifetime. None: no average, as in EARL. Source: Nikishin et al. 2018,
    "Improving Stability in Deep Reinforcement Learning with Weight Averaging"."""
    initial_temperature: float = struct.field(default=1.0, metadata=within("(0, 1000000]"))
    """alpha at step 0 (released code; not given in the paper)."""
    fixed_temperature: bool = struct.field(pytree_node=False, default=False)
    """Whether alpha stays at `initial_temperature`, as in the first version of SAC (arXiv 1801.01290), which the paper
    cites for its figure 2. That version also learns a state value, which this learner does not have."""
    entropy_per_action: float = struct.field(default=-0.5, metadata=within("[-100, 100]", fixed_temperature=True))
    """Target entropy divided by the action size (released code: -|A|/2; not given in the paper)."""
    hidden_sizes: tuple[int, ...] = struct.field(pytree_node=False, default=(256, 256), metadata=within("[1, 65536]"))
    """Widths of the ReLU layers of actor and critics (paper)."""
    layer_norm: bool = struct.field(pytree_node=False, default=False)
    """Whether to normalise the critics' hidden layers. The paper does not; MEDAL and RLPD do, for stability."""
    ensemble: int = struct.field(pytree_node=False, default=SOFT_CRITICS, metadata=within("[2, 100]"))
    """Number of critics with the entropy term (paper: 2; REDQ, RLPD: 10). The actor maximises the minimum of two
    critics, or the mean of more, as in REDQ and RLPD."""
    target_subset: int = struct.field(pytree_node=False, default=SOFT_CRITICS, metadata=within("[1, 100]"))
    """Number of ensemble critics, drawn anew for each update, whose minimum is the target (REDQ, RLPD: 2, or 1)."""
    backup_entropy: bool = struct.field(pytree_node=False, default=True)
    """Whether the target includes the entropy term (paper); RLPD omits it on sparse tasks."""
    pretrain_log_std: float | None = struct.field(default=None, metadata=within("[-20, 2]", pretrain_steps=0))
    """Log standard deviation to which the policy is set after `pretrain_steps`, and which is learnt from then on. None
    keeps the value that these steps leave, which cloning does not fit."""

    name: ClassVar[str] = "sac"
    diagnostics: ClassVar[tuple[str, ...]] = ("critic_loss", "entropy", "temperature")

    def __post_init__(self):
        super().__post_init__()
        if self.target_subset > self.ensemble:
            raise InputError(
                f"target_subset {self.target_subset} is larger than the ensemble of {self.ensemble} critics"
            )

    def init(self, key: jax.Array, obs_size: int, action_size: int, entropy_free_pairs: int = 0) -> Agent:
        actor_key, critic_key = jax.random.split(key)
        actor = MLP((*self.hidden_sizes, 2 * action_size)).init(actor_key, jnp.zeros((obs_size,)))
        network, example = MLP((*self.hidden_sizes, 1), self.layer_norm), jnp.zeros((obs_size + action_size,))
        count = self.ensemble + 2 * entropy_free_pairs
        critics = jax.vmap(network.init, (0, None))(jax.random.split(critic_key, count), example)
        log_temperature = jnp.log(jnp.asarray(self.initial_temperature, jnp.float32))
        moments = {"actor": ADAM.init(actor), "critics": ADAM.init(critics), "temperature": ADAM.init(log_temperature)}
        averaged = None if self.actor_average_rate is None else jax.tree.map(jnp.copy, actor)
        return Agent(actor, critics, jax.tree.map(jnp.copy, critics), log_temperature, moments, averaged)

    def act(self, key: jax.Array, actor: Any, obs: jax.Array) -> jax.Array:
        return self.act_with_log_prob(key, actor, obs)[0]

    def greedy(self, actor: Any, obs: jax.Array) -> jax.Array:
        return networks.mode(self.policy(actor, obs))

    def deployed(self, agent: Agent) -> Any:
        return agent.actor if agent.averaged is None else agent.averaged

    def with_actor(self, agent: Agent, actor: Any) -> Agent:
        """Return `agent` with a cloned `actor` at `pretrain_log_std`; the moving average starts again from it."""
        if self.pretrain_log_std is not None:
            actor = networks.fix_log_std(actor, self.pretrain_log_std)
        return agent.replace(actor=actor, averaged=None if agent.averaged is None else actor)

    def value(self, key: jax.Array, agent: Agent, obs: jax.Array) -> jax.Array:
        """Return the minimum [...] over the entropy-free critics at `obs [..., o]` and an action drawn from the policy.

        Raises:
            ValueError: the method has no `entropy_free_pairs`.
        """
        pairs = jax.tree.map(lambda leaf: leaf[self.ensemble :], agent.critics)
        if not len(jax.tree.leaves(pairs)[0]):
            raise InputError("a method that reads values needs critics without an entropy term: entropy_free_pairs = 1")
        return self.q_values(pairs, obs, self.act(key, agent.actor, obs)).min(axis=0)

    def policy(self, actor: Any, obs: jax.Array) -> jax.Array:
        """Return the parameters [..., 2a] of the action distribution at `obs [..., o]`."""
        return networks.apply(actor, obs, self.precision)

    def q_values(self, critics: Any, obs: jax.Array, action: jax.Array) -> jax.Array:
        """Return the values [K, ...] of K stacked critics at `obs [..., o]` and `action [..., a]`."""
        return networks.q_values(critics, obs, action, self.precision)

    def act_with_log_prob(self, key: jax.Array, actor: Any, obs: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Return reparametrised actions [..., a] and their log-probabilities [...] (appendix C of the SAC paper)."""
        return networks.sample_tanh_normal(self.policy(actor, obs), key)

    def td_target(self, key: jax.Array, agent: Agent, batch: Batch) -> jax.Array:
        """Return the regression targets [K, B]: `scale r + (1 - terminal) gamma (min Q'(s', a') - alpha log pi(a'|s'))`.

        At a terminal transition, which can be a time-out, the target is the scaled reward alone: the biased TD update
        of the EARL paper, section 6.1. The minimum is over a random `target_subset` of the ensemble (Chen et al. 2021,
        REDQ, algorithm 1). Without `backup_entropy`, and for critics after the ensemble, there is no entropy term.
        """
        next_action, log_prob = self.act_with_log_prob(key, agent.actor, batch.next_obs)
        values = self._next_values(key, agent.targets, batch.next_obs, next_action)
        if self.backup_entropy:
            soft = (jnp.arange(values.shape[0]) < self.ensemble)[:, None]
            values = values - soft * jnp.exp(agent.log_temperature) * log_prob
        return self.reward_scale * batch.reward + jnp.where(batch.terminal, 0.0, self.discount * values)

    def _next_values(self, key: jax.Array, targets: Any, obs: jax.Array, action: jax.Array) -> jax.Array:
        """Return the value [K, B] of the next step for each critic: the minimum over its pair or a random subset."""
        if self.ensemble == self.target_subset == SOFT_CRITICS:
            return _pair_min(self.q_values(targets, obs, action))
        chosen = jax.random.permutation(jax.random.fold_in(key, 1), self.ensemble)[: self.target_subset]
        kept = jax.tree.map(lambda leaf: jnp.concatenate([leaf[chosen], leaf[self.ensemble :]]), targets)
        values = self.q_values(kept, obs, action)
        lowest = values[: self.target_subset].min(axis=0)
        own = jnp.broadcast_to(lowest, (self.ensemble, *lowest.shape))
        return jnp.concatenate([own, _pair_min(values[self.target_subset :])])

    def update(self, key: jax.Array, agent: Agent, batch: Batch) -> tuple[Agent, dict[str, jax.Array]]:
        """Return the agent after a step on critics, actor (with the updated critics) and temperature, and diagnostics.

        With `utd` concatenated batches, the critics and their targets make a step on each batch, and the actor makes
        one step on the last. The targets and the averaged actor are updated at the end.
        """
        if self.utd > 1:
            agent, batch = self._repeat_critic_updates(jax.random.fold_in(key, 1), agent, batch)
        critic_key, actor_key = jax.random.split(key)
        agent, critic_loss = self.update_critics(critic_key, agent, batch)
        agent, log_prob = self.update_actor(actor_key, agent, batch)
        agent = self.update_temperature(agent, log_prob, batch.action.shape[-1])
        diagnostics = critic_loss, -log_prob, jnp.exp(agent.log_temperature)
        agent = self._update_targets(agent)
        if self.actor_average_rate is not None:
            agent = agent.replace(averaged=follow(agent.averaged, agent.actor, self.actor_average_rate))
        return agent, dict(zip(SAC.diagnostics, diagnostics, strict=True))

    def _repeat_critic_updates(self, key: jax.Array, agent: Agent, batch: Batch) -> tuple[Agent, Batch]:
        """Return the agent after critic updates on all but the last of `utd` batches, and the last batch."""
        parts = batch.split(self.utd)

        def step(agent, part):
            agent, _ = self.update_critics(part[1], agent, part[0])
            return self._update_targets(agent), None

        earlier, keys = jax.tree.map(lambda leaf: leaf[:-1], parts), jax.random.split(key, self.utd - 1)
        agent, _ = jax.lax.scan(step, agent, (earlier, keys))
        return agent, jax.tree.map(lambda leaf: leaf[-1], parts)._replace(step=batch.step)

    def update_critics(self, key: jax.Array, agent: Agent, batch: Batch) -> tuple[Agent, jax.Array]:
        """Return the agent after a descent step on the squared TD errors of all critics, and their loss []."""
        target = jax.lax.stop_gradient(self.td_target(key, agent, batch))

        def loss(critics):
            errors = self.q_values(critics, batch.obs, batch.action) - target
            return 0.5 * jnp.square(errors).mean(axis=1).sum()

        value, grads = jax.value_and_grad(loss)(agent.critics)
        critics, moments = descend(agent.critics, grads, agent.moments["critics"], self.learning_rate)
        return agent.replace(critics=critics, moments={**agent.moments, "critics": moments}), value

    def update_actor(self, key: jax.Array, agent: Agent, batch: Batch) -> tuple[Agent, jax.Array]:
        """Return the agent after a step on `alpha log pi - min Q` and the cloning term, and the mean log-probability.

        For an ensemble of more than two critics, the mean replaces the minimum.
        """
        temperature = jnp.exp(agent.log_temperature)
        soft = jax.tree.map(lambda leaf: leaf[: self.ensemble], agent.critics)

        def loss(actor):
            parameters = self.policy(actor, batch.obs)
            action, log_prob = networks.sample_tanh_normal(parameters, key)
            values = self.q_values(soft, batch.obs, action)
            # not values.min(axis=0): its gradient is 0 / 0 where XLA computes the values twice with other rounding
            value = jnp.minimum(*values) if self.ensemble == SOFT_CRITICS else values.mean(axis=0)
            total = (temperature * log_prob - value).mean()
            if self.cloning is not None:
                total += cloning_term(self, networks.mode(parameters), batch)
            return total, log_prob.mean()

        grads, log_prob = jax.grad(loss, has_aux=True)(agent.actor)
        actor, moments = descend(agent.actor, grads, agent.moments["actor"], self.learning_rate)
        return agent.replace(actor=actor, moments={**agent.moments, "actor": moments}), log_prob

    def update_temperature(self, agent: Agent, log_prob: jax.Array, action_size: int) -> Agent:
        """Return the agent after a descent step on `-log alpha (log pi + target entropy)`, the released code's loss.

        With `fixed_temperature` the agent is returned unchanged.
        """
        if self.fixed_temperature:
            return agent
        grad = -(log_prob + self.entropy_per_action * action_size)
        value, moments = descend(agent.log_temperature, grad, agent.moments["temperature"], self.learning_rate)
        return agent.replace(log_temperature=value, moments={**agent.moments, "temperature": moments})

    def _update_targets(self, agent: Agent) -> Agent:
        return agent.replace(targets=follow(agent.targets, agent.critics, self.target_rate))


def _pair_min(values: jax.Array) -> jax.Array:
    """Return each critic's clipped double-Q value: the minimum over its pair, [K, ...] -> [K, ...]."""
    pairs = values.reshape(-1, 2, *values.shape[1:]).min(axis=1)
    return jnp.repeat(pairs, 2, axis=0)
