"""Deployed evaluation: what the learnt policy does when it is set down at s0 ~ rho, greedily and without learning."""

from collections.abc import Callable

import jax
import jax.numpy as jnp

from earl_jax.algos.life import Lane, Loop
from earl_jax.algos.method import Method
from earl_jax.envs import Env
from earl_jax.policy import Policy

EVALUATION = 2
"""Folded into a lane's key, so that evaluating neither shifts nor repeats the randomness of the life."""


def episode(
    env: Env, policy: Callable, key: jax.Array, horizon: int, begin: Callable | None = None
) -> dict[str, jax.Array]:
    """Return `success` (at any step) and undiscounted `return` of one episode of `policy(obs) -> action`.

    It starts from `begin(key) -> State`, or s0 ~ rho without one. Where the simulation breaks the episode is over: what comes
    after earns nothing.
    """

    def step(carry, _):
        state, alive, success, total = carry
        state = env.step(state, policy(state.obs))
        alive &= ~env.fault(state)
        success |= alive & env.success(state.obs)
        return (state, alive, success, total + jnp.where(alive, state.reward, 0.0)), None

    start = ((begin or env.reset)(key), jnp.ones((), bool), jnp.zeros((), bool), jnp.zeros(()))
    (_, _, success, total), _ = jax.lax.scan(step, start, length=horizon)
    return {"success": success.astype(jnp.float32), "return": total}


def deployed(
    env: Env, policy: Callable, key: jax.Array, horizon: int, episodes: int, begin: Callable | None = None
) -> dict[str, jax.Array]:
    """Return `deployed/success` and `deployed/return`, means over `episodes` fresh starts and task goals.

    Starts are s0 ~ rho, or drawn by `begin(key) -> State`. Success counts at any step, as the released evaluations do (their
    values are exact multiples of 0.1), although the paper's text speaks of returns.
    """
    keys = jax.random.split(key, episodes)
    results = jax.vmap(lambda part: episode(env, policy, part, horizon, begin))(keys)
    return {f"deployed/{name}": values.mean() for name, values in results.items()}


def deployed_lane(loop: Loop, method: Method, lane: Lane, step: jax.Array) -> dict[str, jax.Array]:
    """Return the deployed evaluation of one lane's task controller after `step` steps, under the loop's protocol."""
    policy = Policy.of(loop.env, method, lane)
    key = jax.random.fold_in(jax.random.fold_in(lane.key, step), EVALUATION)
    return deployed(loop.env, policy, key, loop.protocol.eval_horizon, loop.protocol.eval_episodes)
