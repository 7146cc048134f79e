"""Deployed evaluation: episodes of the greedy policy from s0 ~ rho, without learning."""

from collections.abc import Callable

import jax
import jax.numpy as jnp

from earl_jax.envs import Env, State
from earl_jax.envs.checks import require_like
from earl_jax.envs.help_budget import without_help
from earl_jax.envs.starts import STARTS, starts_of
from earl_jax.envs.state import tree_where
from earl_jax.errors import InputError
from earl_jax.options.jax_settings import package_types
from earl_jax.options.values import COUNT, EPISODES, require

WIDE = "deployed/success_wide"
"""The metric of episodes from `Env.starts.wide`, on tasks that have such starts."""
WIDE_KEY = 1
"""Number folded into the key of an evaluation for wide starts, so that they do not change the ordinary starts."""


def episode(env: Env, policy: Callable, state: State, horizon: int) -> dict[str, jax.Array]:
    """Return `success` (at any step) and undiscounted `return` of one episode of `policy(obs) -> action` from `state`.

    A step that breaks the simulation does not take place: the state stays as it was, and earns its reward again. With an
    action that is not finite, the return is nan: an episode that ends early would beat others of negative rewards.
    """

    def step(carry, _):
        state, success, total = carry
        action = _action(policy, state.obs)
        moved = env.step(state, action)
        is_broken = env.fault(moved)
        state = tree_where(is_broken, state, moved)
        success |= ~is_broken & env.success(state.obs)
        return (state, success, total + jnp.where(jnp.isfinite(action).all(), state.reward, jnp.nan)), None

    first = (state, jnp.zeros((), bool), jnp.zeros(()))
    (_, success, total), _ = jax.lax.scan(step, first, length=horizon)
    return {"success": success.astype(jnp.float32), "return": total}


def _action(policy: Callable, obs: jax.Array) -> jax.Array:
    """Return `policy(obs)`; an InputError if it needs the values of `obs`, which a program that is compiled does not have."""
    try:
        return jnp.asarray(policy(obs))
    except (jax.errors.TracerArrayConversionError, jax.errors.ConcretizationTypeError, AttributeError) as error:
        if isinstance(error, AttributeError) and "Tracer" not in str(error):  # as PyTorch's conversion raises
            raise
        remedy = "write it in jax.numpy, or call it through jax.pure_callback (docs/custom_loops.md)"
        raise InputError(f"the policy is compiled, and needs the values of its obs: {remedy}") from error


@package_types()
def deployed(
    env: Env,
    policy: Callable,
    key: jax.Array,
    horizon: int,
    episodes: int,
    start: str | Callable = STARTS[0],
    wide: Callable | None = None,
    pairs: str = "random",
) -> dict[str, jax.Array]:
    """Return `deployed/success` and `deployed/return`, means over `episodes` fresh starts and task goals.

    Starts are s0 ~ rho, the task's `uniform` or `wide` ones, or drawn by `start(key) -> State`. `pairs="balanced"`
    uses every pair of initial state and task goal equally often (`balanced_starts`), so the mean does not depend on
    the luck of the draw. There is no help: in a `HelpBudget`, requests have no effect and nothing is charged. Success
    at any step counts, as in the released evaluations, whose values are exact multiples of 0.1, although the paper's
    text speaks of returns. With `wide(key) -> State`, `deployed/success_wide` is the success of as many further
    episodes from these starts (our metric; docs/formalism.md says why). They are part of the same scan and change no
    other episode.

    Raises:
        ValueError: `pairs` or `start` is unknown, the task has no such starts, `balanced` is combined with other starts
            than the initial ones, `episodes` or `horizon` is not a positive whole number, or `policy` computes outside
            jax.
    """
    env = without_help(env)
    draw = starts_of(env, start, pairs)
    require("episodes", episodes, EPISODES)
    require("horizon", horizon, COUNT)
    states = draw(key, episodes)
    if wide is not None:
        wide_keys = jax.random.split(jax.random.fold_in(key, WIDE_KEY), episodes)
        wide_states = jax.vmap(wide)(wide_keys)
        require_like(f"{env.name}: starts.wide must return a state", wide_states, states)
        states = jax.tree.map(lambda *parts: jnp.concatenate(parts), states, wide_states)
    results = jax.vmap(lambda state: episode(env, policy, state, horizon))(states)
    metrics = {f"deployed/{name}": values[:episodes].mean() for name, values in results.items()}
    return metrics if wide is None else {**metrics, WIDE: results["success"][episodes:].mean()}
