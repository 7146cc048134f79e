"""A random agent lives one life without resets: `python examples/random_agent.py`."""

import jax
import jax.numpy as jnp

import earl_jax
from earl_jax.protocol import advance, evaluate, init


def live(env, protocol, key, windows):
    """Return the metrics [E] of a life of so many windows of `protocol.eval_every` steps."""

    def step(state, key):
        action = jax.random.uniform(key, (env.action_size,), minval=-1.0, maxval=1.0)
        return advance(env, state, action)

    def window(state, key):
        state, _ = jax.lax.scan(step, state, jax.random.split(key, protocol.eval_every))
        return evaluate(env, protocol, state, lambda obs: jnp.zeros(env.action_size))  # of the mean action

    state = init(env, protocol, key)
    return jax.lax.scan(window, state, jax.random.split(jax.random.fold_in(key, 1), windows))[1]


if __name__ == "__main__":
    env = earl_jax.make("tabletop_organization")
    protocol = earl_jax.Deployment(intervention_chance=1e-3).protocol(env, eval_every=10_000)
    print(jax.jit(lambda key: live(env, protocol, key, windows=5))(jax.random.key(0)))
