"""Deployed evaluation: episodes of the greedy policy from s0 ~ rho, without learning."""

from collections.abc import Callable

import jax
import jax.numpy as jnp

from earl_jax.envs import Env


def episode(
    env: Env, policy: Callable, key: jax.Array, horizon: int, start: Callable | None = None
) -> dict[str, jax.Array]:
    """Return `success` (at any step) and undiscounted `return` of one episode of `policy(obs) -> action`.

    It starts from `start(key) -> State`, s0 ~ rho by default. A broken simulation ends the episode: later steps earn no
    reward.
    """

    def step(carry, _):
        state, intact, success, total = carry
        state = env.step(state, policy(state.obs))
        intact &= ~env.fault(state)
        success |= intact & env.success(state.obs)
        return (state, intact, success, total + jnp.where(intact, state.reward, 0.0)), None

    first = ((start or env.reset)(key), jnp.ones((), bool), jnp.zeros((), bool), jnp.zeros(()))
    (_, _, success, total), _ = jax.lax.scan(step, first, length=horizon)
    return {"success": success.astype(jnp.float32), "return": total}


def deployed(
    env: Env, policy: Callable, key: jax.Array, horizon: int, episodes: int, start: Callable | None = None
) -> dict[str, jax.Array]:
    """Return `deployed/success` and `deployed/return`, means over `episodes` fresh starts and task goals.

    Starts are s0 ~ rho, or drawn by `start(key) -> State`. Success counts at any step, as in the released evaluations,
    whose values are exact multiples of 0.1, although the paper's text speaks of returns.
    """
    keys = jax.random.split(key, episodes)
    results = jax.vmap(lambda episode_key: episode(env, policy, episode_key, horizon, start))(keys)
    return {f"deployed/{name}": values.mean() for name, values in results.items()}
