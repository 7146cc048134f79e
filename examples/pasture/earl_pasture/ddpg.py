"""DDPG: a deterministic policy that climbs one critic."""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from flax import struct

from earl_jax.algos.learner.base import Batch, Learner
from earl_jax.algos.learner.networks import ADAM, MLP, apply, descend, follow
from earl_jax.errors import InputError


class Agent(struct.PyTreeNode):
    """Actor and critic, their targets, and Adam's moments of both."""

    actor: Any
    critic: Any
    targets: Any
    moments: Any


class DDPG(Learner):
    """Regress the critic on `r + gamma Q'(s', pi'(s'))`, then climb `Q(s, pi(s))`."""

    noise: float = 0.1
    """Standard deviation of the noise on actions in the lifetime."""
    target_rate: float = 0.005
    """Share by which both targets follow in a step."""
    hidden_sizes: tuple[int, ...] = struct.field(pytree_node=False, default=(256, 256))

    name: ClassVar[str] = "ddpg"
    diagnostics: ClassVar[tuple[str, ...]] = ("critic_loss",)

    def __post_init__(self):
        super().__post_init__()
        if self.utd != 1 or self.cloning is not None:
            raise InputError("ddpg has neither utd nor cloning")

    def init(self, key: jax.Array, obs_size: int, action_size: int, entropy_free_pairs: int = 0) -> Agent:
        actor_key, critic_key = jax.random.split(key)
        actor = MLP((*self.hidden_sizes, action_size)).init(actor_key, jnp.zeros(obs_size))
        critic = MLP((*self.hidden_sizes, 1)).init(critic_key, jnp.zeros(obs_size + action_size))
        targets = jax.tree.map(jnp.copy, (actor, critic))
        return Agent(actor, critic, targets, (ADAM.init(actor), ADAM.init(critic)))

    def act(self, key: jax.Array, actor: Any, obs: jax.Array) -> jax.Array:
        greedy = self.greedy(actor, obs)
        return jnp.clip(greedy + self.noise * jax.random.normal(key, greedy.shape), -1.0, 1.0)

    def greedy(self, actor: Any, obs: jax.Array) -> jax.Array:
        return jnp.tanh(apply(actor, obs, self.precision))

    def q(self, critic: Any, obs: jax.Array, action: jax.Array) -> jax.Array:
        return apply(critic, jnp.concatenate([obs, action], axis=-1), self.precision)[..., 0]

    def update(self, key: jax.Array, agent: Agent, batch: Batch) -> tuple[Agent, dict[str, jax.Array]]:
        actor, critic = agent.targets
        following = self.q(critic, batch.next_obs, self.greedy(actor, batch.next_obs))
        target = self.reward_scale * batch.reward + jnp.where(batch.terminal, 0.0, self.discount * following)

        def critic_loss(critic):
            return jnp.square(self.q(critic, batch.obs, batch.action) - target).mean()

        def actor_loss(actor, critic):
            return -self.q(critic, batch.obs, self.greedy(actor, batch.obs)).mean()

        loss, grads = jax.value_and_grad(critic_loss)(agent.critic)
        critic, critic_moments = descend(agent.critic, grads, agent.moments[1], self.learning_rate)
        grads = jax.grad(actor_loss)(agent.actor, critic)
        actor, actor_moments = descend(agent.actor, grads, agent.moments[0], self.learning_rate)
        targets = follow(agent.targets, (actor, critic), self.target_rate)
        return Agent(actor, critic, targets, (actor_moments, critic_moments)), {"critic_loss": loss}
