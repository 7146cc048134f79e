"""Deployed evaluation: episodes of the greedy policy from s0 ~ rho, without learning."""

from collections.abc import Callable

import jax
import jax.numpy as jnp

from earl_jax.envs import Env, State, balanced_starts
from earl_jax.envs.starts import EVAL_PAIRS
from earl_jax.errors import InputError, require_known
from earl_jax.options.jax_settings import package_types
from earl_jax.options.values import COUNT, EPISODES, require

WIDE = "deployed/success_wide"
"""The metric of episodes from `Env.starts.wide`, on tasks that have it."""
WIDE_KEY = 1
"""Folded into the key of an evaluation for wide starts, so that the ordinary ones stay as they are."""


def episode(env: Env, policy: Callable, state: State, horizon: int) -> dict[str, jax.Array]:
    """Return `success` (at any step) and undiscounted `return` of one episode of `policy(obs) -> action` from `state`.

    A broken simulation ends the episode: later steps earn no reward.
    """

    def step(carry, _):
        state, intact, success, total = carry
        try:
            action = policy(state.obs)
        except jax.errors.TracerArrayConversionError as error:
            raise InputError(
                "the policy needs arrays of NumPy: call it by jax.pure_callback (docs/custom_loops.md)"
            ) from error
        state = env.step(state, action)
        intact &= ~env.fault(state)
        success |= intact & env.success(state.obs)
        return (state, intact, success, total + jnp.where(intact, state.reward, 0.0)), None

    first = (state, jnp.ones((), bool), jnp.zeros((), bool), jnp.zeros(()))
    (_, _, success, total), _ = jax.lax.scan(step, first, length=horizon)
    return {"success": success.astype(jnp.float32), "return": total}


@package_types()
def deployed(
    env: Env,
    policy: Callable,
    key: jax.Array,
    horizon: int,
    episodes: int,
    start: Callable | None = None,
    wide: Callable | None = None,
    pairs: str = "random",
) -> dict[str, jax.Array]:
    """Return `deployed/success` and `deployed/return`, means over `episodes` fresh starts and task goals.

    Starts are s0 ~ rho, or drawn by `start(key) -> State`. `pairs="balanced"` takes every pair of start and task goal
    equally often instead (`balanced_starts`), which removes the chance of the draw from the mean. Success counts at any
    step, as in the released evaluations, whose values are exact multiples of 0.1, although the paper's text speaks of
    returns. With `wide(key) -> State` there is also `deployed/success_wide`, of as many episodes from such starts (ours;
    docs/formalism.md says why). They are part of the same scan, and change no other episode.

    Raises:
        ValueError: `pairs` is unknown, `episodes` or `horizon` are no whole number from one on, or `policy` computes outside
            jax.
    """
    require_known("pairs", pairs, EVAL_PAIRS)
    require("episodes", episodes, EPISODES)
    require("horizon", horizon, COUNT)
    if pairs == "balanced":
        states = balanced_starts(env, key, episodes)
    else:
        states = jax.vmap(start or env.reset)(jax.random.split(key, episodes))
    if wide is not None:
        wide_keys = jax.random.split(jax.random.fold_in(key, WIDE_KEY), episodes)
        states = jax.tree.map(lambda *parts: jnp.concatenate(parts), states, jax.vmap(wide)(wide_keys))
    results = jax.vmap(lambda state: episode(env, policy, state, horizon))(states)
    metrics = {f"deployed/{name}": values[:episodes].mean() for name, values in results.items()}
    return metrics if wide is None else {**metrics, WIDE: results["success"][episodes:].mean()}
