"""Soft actor-critic, the learner of all methods: a gradient step on the critics, the actor and the temperature.

Source: Haarnoja et al. 2018 (arXiv 1812.05905), with the shared hyper-parameters of Sharma et al. 2022, appendix.
Defaults that the paper does not give follow the authors' released TF-Agents code; each field names its source.
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from flax import struct

from earl_jax.algos.learner import networks
from earl_jax.algos.learner.networks import TanhNormal, mlp
from earl_jax.options import COUNT, LARGEST_INT, within

SOFT_CRITICS = 2
DIAGNOSTICS: tuple[str, ...] = ("critic_loss", "entropy", "temperature")


class SAC(struct.PyTreeNode):
    """Hyper-parameters of the learner; floats are leaves, so lanes of one program can have different values."""

    learning_rate: float = struct.field(default=3e-4, metadata=within("(0, 1]"))
    """Adam's step size for actor, critics and temperature (paper)."""
    discount: float = struct.field(default=0.99, metadata=within("[0, 1)"))
    """gamma (paper)."""
    target_rate: float = struct.field(default=0.005, metadata=within("(0, 1]"))
    """tau of the target critics, which are updated every step (paper)."""
    reward_scale: float = struct.field(default=10.0, metadata=within("(0, 1000000]"))
    """Factor on the reward inside the learner only. The paper gives 1. The released configurations of sparse tasks give
    10, which reproduces the published curves (docs/results.md). Training by name uses `Env.reward_scale` instead."""
    initial_temperature: float = struct.field(default=1.0, metadata=within("(0, 1000000]"))
    """alpha at step 0 (released code; not given in the paper)."""
    fixed_temperature: bool = struct.field(pytree_node=False, default=False)
    """Whether alpha stays at `initial_temperature`, as in the first version of SAC (arXiv 1801.01290), which the paper
    cites for its figure 2; that version also learns a state value, which this learner lacks."""
    entropy_per_action: float = struct.field(default=-0.5, metadata=within("[-100, 100]"))
    """Target entropy divided by the action size (released code: -|A|/2; not given in the paper)."""
    timeout_bootstrap: bool = False
    """Whether to bootstrap through the end of a phase that timed out; not in EARL, where every phase end is
    terminal."""
    demo_share: float = struct.field(default=0.0, metadata=within("[0, 1]"))
    """Share of a batch drawn from the demonstrations alone; 0 as in EARL, which samples all transitions uniformly."""
    batch_size: int = struct.field(pytree_node=False, default=256, metadata=within("[1, 1048576]"))
    """Transitions in a gradient step, drawn uniformly with replacement (paper)."""
    hidden_sizes: tuple[int, ...] = struct.field(pytree_node=False, default=(256, 256), metadata=within("[1, 65536]"))
    """Widths of the ReLU layers of actor and critics (paper)."""
    layer_norm: bool = struct.field(pytree_node=False, default=False)
    """Whether to normalise the critics' hidden layers; not in the paper, but in later work (MEDAL, RLPD) for
    stability."""
    replay_capacity: int | None = struct.field(pytree_node=False, default=None, metadata=within(COUNT))
    """Own transitions of a lane that the replay keeps, first in, first out; None: all. The paper gives 20M and 10M, more
    than any of its runs has."""
    random_steps: int = struct.field(pytree_node=False, default=1000, metadata=within(f"[0, {LARGEST_INT}]"))
    """Number of uniformly random actions, without updates, at the start of a lifetime (paper)."""
    precision: str = struct.field(pytree_node=False, default="tf32")
    """Precision of the networks' matrix products: "float32" (on every device), "tf32" (XLA's default: TF32 on NVIDIA
    GPUs, float32 on CPUs) or "bf16" (bfloat16 operands and activations; parameters, sums, losses and Adam stay
    float32)."""

    def __post_init__(self):
        networks.check_precision(self.precision)


class Batch(NamedTuple):
    """Transitions to learn from: `obs, next_obs [B, o]`, `action [B, a]`, `reward [B]`, bool `terminal [B]`."""

    obs: jax.Array
    action: jax.Array
    reward: jax.Array
    terminal: jax.Array
    next_obs: jax.Array


class Agent(struct.PyTreeNode):
    """One controller: actor, K stacked critics and their targets, log temperature, Adam's moments.

    The first two critics are SAC's. Further critics are trained without the entropy term, for methods that interpret
    values as success probabilities.
    """

    actor: Any
    critics: Any
    targets: Any
    log_temperature: jax.Array
    moments: dict[str, Any]


ADAM = optax.scale_by_adam()


def _critic(sac: SAC) -> Any:
    return mlp(sac.hidden_sizes, 1, sac.layer_norm)


def _policy(sac: SAC, actor: Any, obs: jax.Array, action_size: int) -> jax.Array:
    """Return the parameters [..., 2a] of the action distribution at `obs [..., o]`."""
    return networks.apply(mlp(sac.hidden_sizes, 2 * action_size), actor, obs, sac.precision)


def init(key: jax.Array, sac: SAC, obs_size: int, action_size: int, critics: int = SOFT_CRITICS) -> Agent:
    """Return a fresh `Agent` for observations [o] and actions [a] with `critics` >= 2 stacked critics."""
    actor_key, critic_key = jax.random.split(key)
    actor = mlp(sac.hidden_sizes, 2 * action_size).init(actor_key, jnp.zeros((obs_size,)))
    example = jnp.zeros((obs_size + action_size,))
    critic = jax.vmap(_critic(sac).init, (0, None))(jax.random.split(critic_key, critics), example)
    log_temperature = jnp.log(jnp.asarray(sac.initial_temperature, jnp.float32))
    moments = {
        "actor": ADAM.init(actor),
        "critics": ADAM.init(critic),
        "temperature": ADAM.init(log_temperature),
    }
    return Agent(actor, critic, jax.tree.map(jnp.copy, critic), log_temperature, moments)


def act(sac: SAC, actor: Any, obs: jax.Array, key: jax.Array, action_size: int) -> jax.Array:
    """Return actions [..., a] sampled from the policy at `obs [..., o]`."""
    return TanhNormal(action_size).sample(_policy(sac, actor, obs, action_size), key)


def greedy(sac: SAC, actor: Any, obs: jax.Array, action_size: int) -> jax.Array:
    """Return the policy's mode [..., a] at `obs [..., o]`, the action in evaluations."""
    return TanhNormal(action_size).mode(_policy(sac, actor, obs, action_size))


def act_with_log_prob(sac: SAC, actor: Any, obs: jax.Array, key: jax.Array, size: int) -> tuple[jax.Array, jax.Array]:
    """Return reparametrised actions [..., a] and their log-probabilities [...] (appendix C of the SAC paper)."""
    policy, parameters = TanhNormal(size), _policy(sac, actor, obs, size)
    raw = policy.sample_no_postprocessing(parameters, key)
    return policy.postprocess(raw), policy.log_prob(parameters, raw)


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


def td_target(sac: SAC, agent: Agent, batch: Batch, key: jax.Array) -> jax.Array:
    """Return the regression targets [K, B]: `scale r + (1 - terminal) gamma (min Q'(s', a') - alpha log pi(a'|s'))`.

    At a terminal transition, time-outs included, the target is the scaled reward alone: the biased TD update of the
    EARL paper, section 5.1. Critics after the first two omit the entropy term.
    """
    next_action, log_prob = act_with_log_prob(sac, agent.actor, batch.next_obs, key, batch.action.shape[-1])
    values = _pair_min(q_values(sac, agent.targets, batch.next_obs, next_action))
    soft = (jnp.arange(values.shape[0]) < SOFT_CRITICS)[:, None]
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


def _update_actor(sac: SAC, agent: Agent, batch: Batch, key: jax.Array) -> tuple[Agent, jax.Array]:
    """Return the agent after a descent step on `alpha log pi - min Q`, and the mean log-probability."""
    temperature = jnp.exp(agent.log_temperature)
    soft = jax.tree.map(lambda leaf: leaf[:SOFT_CRITICS], agent.critics)

    def loss(actor):
        action, log_prob = act_with_log_prob(sac, actor, batch.obs, key, batch.action.shape[-1])
        value = q_values(sac, soft, batch.obs, action).min(axis=0)
        return (temperature * log_prob - value).mean(), log_prob.mean()

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


def update(sac: SAC, agent: Agent, batch: Batch, key: jax.Array) -> tuple[Agent, dict[str, jax.Array]]:
    """Return the agent after a step on critics, actor (with the updated critics) and temperature, and diagnostics."""
    critic_key, actor_key = jax.random.split(key)
    agent, critic_loss = _update_critics(sac, agent, batch, critic_key)
    agent, log_prob = _update_actor(sac, agent, batch, actor_key)
    agent = _update_temperature(sac, agent, log_prob, batch.action.shape[-1])
    targets = jax.tree.map(lambda slow, fast: slow + sac.target_rate * (fast - slow), agent.targets, agent.critics)
    diagnostics = critic_loss, -log_prob, jnp.exp(agent.log_temperature)
    return agent.replace(targets=targets), dict(zip(DIAGNOSTICS, diagnostics, strict=True))
