"""Twin delayed deep deterministic policy gradient: a second learner, for comparison and as an example.

Source: Fujimoto, van Hoof and Meger 2018 (TD3, arXiv 1802.09477), algorithm 1; each field names its source.
"""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from flax import struct

from earl_jax.algos.learner import networks
from earl_jax.algos.learner.base import Batch, Learner
from earl_jax.algos.learner.cloning import cloning_term
from earl_jax.algos.learner.networks import ADAM, MLP, descend, follow
from earl_jax.options.values import within


class Agent(struct.PyTreeNode):
    """One controller: actor and two stacked critics, their targets, Adam's moments, and the actor's last loss."""

    actor: Any
    critics: Any
    target_actor: Any
    target_critics: Any
    actor_moments: Any
    critic_moments: Any
    actor_loss: jax.Array


class TD3(Learner):
    """Maximise the first of two critics with a deterministic policy, which is updated every `policy_delay` steps.

    With noise e ~ clip(N(0, target_noise), -noise_clip, noise_clip), both critics regress on
    `scale r + (1 - terminal) gamma min_i Q'_i(s', clip(pi'(s') + e, -1, 1))`, and the policy maximises Q_1(s, pi(s)).
    Deliberate differences: networks and their initialisation are those of `SAC`, with EARL's widths and step size as
    defaults (TD3: 400 and 300, 1e-3); the delay counts the steps of the lifetime; with `utd` batches, the critics learn
    from every batch and the policy from the last.

    Source: Fujimoto, van Hoof and Meger 2018, "Addressing Function Approximation Error in Actor-Critic Methods" (TD3).
    """

    target_rate: float = struct.field(default=0.005, metadata=within("(0, 1]"))
    """tau of both targets (TD3, EARL)."""
    policy_delay: int = struct.field(pytree_node=False, default=2, metadata=within("[1, 1000]"))
    """Steps between updates of the policy and of the targets (TD3)."""
    exploration_noise: float = struct.field(default=0.1, metadata=within("[0, 10]"))
    """Standard deviation of the exploration noise on actions in the lifetime (TD3)."""
    target_noise: float = struct.field(default=0.2, metadata=within("[0, 10]"))
    """Standard deviation of the noise on the target policy's actions (TD3)."""
    noise_clip: float = struct.field(default=0.5, metadata=within("[0, 10]", target_noise=0.0))
    """Largest absolute value of the noise on the target policy's actions (TD3)."""
    hidden_sizes: tuple[int, ...] = struct.field(pytree_node=False, default=(256, 256), metadata=within("[1, 65536]"))
    """Widths of the ReLU layers of actor and critics (EARL)."""
    layer_norm: bool = struct.field(pytree_node=False, default=False)
    """Whether to normalise the critics' hidden layers."""

    name: ClassVar[str] = "td3"
    diagnostics: ClassVar[tuple[str, ...]] = ("critic_loss", "actor_loss")

    def init(self, key: jax.Array, obs_size: int, action_size: int, entropy_free_pairs: int = 0) -> Agent:
        actor_key, critic_key = jax.random.split(key)
        actor = MLP((*self.hidden_sizes, action_size)).init(actor_key, jnp.zeros((obs_size,)))
        network, example = MLP((*self.hidden_sizes, 1), self.layer_norm), jnp.zeros((obs_size + action_size,))
        critics = jax.vmap(network.init, (0, None))(jax.random.split(critic_key, 2), example)
        target_actor, targets = jax.tree.map(jnp.copy, (actor, critics))
        return Agent(actor, critics, target_actor, targets, ADAM.init(actor), ADAM.init(critics), jnp.zeros(()))

    def act(self, key: jax.Array, actor: Any, obs: jax.Array) -> jax.Array:
        greedy = self.greedy(actor, obs)
        return jnp.clip(greedy + self.exploration_noise * jax.random.normal(key, greedy.shape), -1.0, 1.0)

    def greedy(self, actor: Any, obs: jax.Array) -> jax.Array:
        return jnp.tanh(networks.apply(actor, obs, self.precision))

    def with_actor(self, agent: Agent, actor: Any) -> Agent:
        return agent.replace(actor=actor, target_actor=actor)

    def value(self, key: jax.Array, agent: Agent, obs: jax.Array) -> jax.Array:
        """Return the smaller value [...] of the two critics at `obs [..., o]` and an action with exploration noise."""
        return self.q_values(agent.critics, obs, self.act(key, agent.actor, obs)).min(axis=0)

    def q_values(self, critics: Any, obs: jax.Array, action: jax.Array) -> jax.Array:
        """Return the values [2, ...] of both critics at `obs [..., o]` and `action [..., a]`."""
        return networks.q_values(critics, obs, action, self.precision)

    def td_target(self, key: jax.Array, agent: Agent, batch: Batch) -> jax.Array:
        """Return the regression target [B] of both critics, with target policy smoothing (section 5.3 of the paper)."""
        noise = self.target_noise * jax.random.normal(key, batch.action.shape)
        noise = jnp.clip(noise, -self.noise_clip, self.noise_clip)
        action = jnp.clip(self.greedy(agent.target_actor, batch.next_obs) + noise, -1.0, 1.0)
        value = self.q_values(agent.target_critics, batch.next_obs, action).min(axis=0)
        return self.reward_scale * batch.reward + jnp.where(batch.terminal, 0.0, self.discount * value)

    def update(self, key: jax.Array, agent: Agent, batch: Batch) -> tuple[Agent, dict[str, jax.Array]]:
        """Return the agent after a critic step on each batch and an actor step if one is due, and the last losses.

        The condition is the same in all lanes, so the branch stays a branch under vmap.
        """

        def step(agent, part):
            return self.update_critics(part[0], agent, part[1])

        parts = batch.split(self.utd)
        agent, losses = jax.lax.scan(step, agent, (jax.random.split(key, self.utd), parts))
        last = jax.tree.map(lambda leaf: leaf[-1], parts)._replace(step=batch.step)
        assert batch.step is not None
        due = (batch.step + 1) % self.policy_delay == 0
        agent = jax.lax.cond(due, self.update_actor, lambda agent, _: agent, agent, last)
        return agent, {"critic_loss": losses[-1], "actor_loss": agent.actor_loss}

    def update_critics(self, key: jax.Array, agent: Agent, batch: Batch) -> tuple[Agent, jax.Array]:
        """Return the agent after a descent step on the squared TD errors of both critics, and their loss []."""
        target = jax.lax.stop_gradient(self.td_target(key, agent, batch))

        def loss(critics):
            return jnp.square(self.q_values(critics, batch.obs, batch.action) - target).mean(axis=1).sum()

        value, grads = jax.value_and_grad(loss)(agent.critics)
        critics, moments = descend(agent.critics, grads, agent.critic_moments, self.learning_rate)
        return agent.replace(critics=critics, critic_moments=moments), value

    def update_actor(self, agent: Agent, batch: Batch) -> Agent:
        """Return the agent after a step of the actor on `-Q_1` and the cloning term, and of all targets."""

        def loss(actor):
            action = self.greedy(actor, batch.obs)
            total = -self.q_values(agent.critics, batch.obs, action)[0].mean()
            return total if self.cloning is None else total + cloning_term(self, action, batch)

        value, grads = jax.value_and_grad(loss)(agent.actor)
        actor, moments = descend(agent.actor, grads, agent.actor_moments, self.learning_rate)
        targets = follow((agent.target_actor, agent.target_critics), (actor, agent.critics), self.target_rate)
        agent = agent.replace(actor=actor, actor_moments=moments, actor_loss=value)
        return agent.replace(target_actor=targets[0], target_critics=targets[1])
