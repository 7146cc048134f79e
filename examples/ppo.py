"""PPO (Schulman et al. 2017) on one life with few resets for each seed: `python examples/ppo.py`."""

from typing import NamedTuple

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax.scipy.stats import norm

import earl_jax
from earl_jax.protocol import StepResult, advance, evaluate, init, lifetime_scores

ROLLOUT, EPOCHS, MINIBATCHES, ATTEMPT_STEPS = 1_000, 10, 20, 200
DISCOUNT, TRACE, CLIP, ENTROPY, LEARNING_RATE = 0.97, 0.95, 0.2, 1e-3, 3e-4
OPTIMISER = optax.chain(optax.clip_by_global_norm(0.5), optax.adam(LEARNING_RATE, eps=1e-5))


class ActorCritic(nn.Module):
    """A Gaussian policy and a value of `obs [..., s + g]`."""

    action_size: int

    @nn.compact
    def __call__(self, obs):
        """Return the mean [..., a] and the logarithm of the standard deviation [a] of the action, and the value [...]."""

        def dense(size, gain):
            # Not orthogonal: under vmap, jaxlib 0.10 can hang on two cores in QR factorisations that wait for each other.
            return nn.Dense(size, kernel_init=nn.initializers.variance_scaling(gain**2, "fan_in", "normal"))

        def network(size, gain):
            hidden = obs
            for _ in range(2):
                hidden = nn.tanh(dense(64, 2**0.5)(hidden))
            return dense(size, gain)(hidden)

        log_std = self.param("log_std", nn.initializers.constant(-0.5), (self.action_size,))
        return network(self.action_size, 0.01), log_std, network(1, 1.0)[..., 0]


class Transition(NamedTuple):
    """A step of the life, with the log-probability of its action under the policy that took it."""

    obs: jax.Array
    action: jax.Array
    log_prob: jax.Array
    result: StepResult


def advantages_of(result, values, next_values):
    """Return the generalised advantages [T] of a rollout (Schulman et al. 2016), for rewards scaled by 1 - DISCOUNT.

    A success ends an attempt. After a time-out or an intervention the value of `next_obs` stands for what would follow.
    """
    terminal = result.end.reached | result.terminated
    errors = (1 - DISCOUNT) * result.reward + DISCOUNT * next_values * ~terminal - values

    def backward(following, step):
        error, goes_on = step
        return (error + DISCOUNT * TRACE * goes_on * following,) * 2

    return jax.lax.scan(backward, 0.0, (errors, ~(terminal | result.end.phase_ended)), reverse=True)[1]


def loss_of(params, network, batch, advantages, targets):
    """Return the clipped surrogate loss with the losses of value and entropy (Schulman et al. 2017, equation 9)."""
    mean, log_std, values = network.apply(params, batch.obs)
    ratio = jnp.exp(norm.logpdf(batch.action, mean, jnp.exp(log_std)).sum(-1) - batch.log_prob)
    advantages = (advantages - advantages.mean()) / (advantages.std() + 1e-8)
    surrogate = jnp.minimum(ratio * advantages, jnp.clip(ratio, 1 - CLIP, 1 + CLIP) * advantages).mean()
    return 0.5 * jnp.square(values - targets).mean() - surrogate - ENTROPY * log_std.sum()


def learn(network, params, moments, batch, key):
    """Return the parameters and the optimiser's state after all epochs on a rollout `batch` [T]."""
    values, next_values = (network.apply(params, obs)[2] for obs in (batch.obs, batch.result.next_obs))
    advantages = advantages_of(batch.result, values, next_values)
    data = batch, advantages, advantages + values

    def update(carry, rows):
        params, moments = carry
        gradient = jax.grad(loss_of)(params, network, *jax.tree.map(lambda leaf: leaf[rows], data))
        change, moments = OPTIMISER.update(gradient, moments)
        return (optax.apply_updates(params, change), moments), None

    rows = jax.vmap(lambda key: jax.random.permutation(key, len(values)))(jax.random.split(key, EPOCHS))
    return jax.lax.scan(update, (params, moments), rows.reshape(EPOCHS * MINIBATCHES, -1))[0]


def live(env, protocol, key, windows, rollout=ROLLOUT):
    """Return the metrics [E] of one life of so many windows of `protocol.eval_every` steps, a multiple of `rollout`."""
    network = ActorCritic(env.action_size)
    life_key, network_key, key = jax.random.split(key, 3)
    state = init(env, protocol, life_key, ATTEMPT_STEPS)
    params = network.init(network_key, state.obs)

    def step(carry, key):
        params, state = carry
        mean, log_std, _ = network.apply(params, state.obs)
        action = mean + jnp.exp(log_std) * jax.random.normal(key, mean.shape)  # the environment clips it to [-1, 1]
        log_prob = norm.logpdf(action, mean, jnp.exp(log_std)).sum()
        following, result = advance(env, state, action)
        return (params, following), Transition(state.obs, action, log_prob, result)

    def iteration(carry, key):
        params, moments, state = carry
        act_key, learn_key = jax.random.split(key)
        (_, state), batch = jax.lax.scan(step, (params, state), jax.random.split(act_key, rollout))
        return (*learn(network, params, moments, batch, learn_key), state), None

    def window(carry, key):
        keys = jax.random.split(key, protocol.eval_every // rollout)
        (params, moments, state), _ = jax.lax.scan(iteration, carry, keys)
        state, metrics = evaluate(env, protocol, state, lambda obs: network.apply(params, obs)[0])
        return (params, moments, state), metrics

    return jax.lax.scan(window, (params, OPTIMISER.init(params), state), jax.random.split(key, windows))[1]


if __name__ == "__main__":
    env = earl_jax.make("tabletop_organization", reward_type="dense", train_horizon=1_000)
    protocol = earl_jax.Deployment().protocol(env, eval_every=10_000)
    keys = jax.random.split(jax.random.key(1), 10)
    metrics = jax.jit(jax.vmap(lambda key: live(env, protocol, key, windows=10)))(keys)
    for name in ("deployed/return", "continuing/recent"):
        print(name, np.asarray(metrics[name]).round(2), sep="\n")
    print(lifetime_scores(np.arange(1, 11) * protocol.eval_every, metrics, "deployed/return"))
