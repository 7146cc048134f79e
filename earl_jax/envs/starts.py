"""The distributions of starts of an evaluation, by name."""

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp

from earl_jax.envs.base import Env
from earl_jax.envs.state import State
from earl_jax.errors import InputError, require_known
from earl_jax.options.jax_settings import package_types

STARTS = ("initial", "uniform", "wide")
"""Distributions: s0 ~ rho, uniform over the workspace (figure 4 of the paper), and that of `deployed/success_wide`."""
EVAL_PAIRS = ("random", "balanced")
"""How an evaluation draws its pairs of start and task goal: each at random, or every pair equally often."""
PAIR_KEY = 2
"""Number folded into the key of an evaluation to draw the order of balanced pairs."""


def start_of(env: Env, starts: str) -> Callable[[jax.Array], State]:
    """Return the function `start(key) -> State` of the distribution `starts` of `env`.

    Raises:
        ValueError: the name is unknown, or the task has no such starts.
    """
    require_known("starts", starts, STARTS)
    if starts == "initial":
        return env.reset
    start = env.starts.wide if starts == "wide" else env.starts.uniform
    if start is None:
        reason = ": they belong to sparse tasks whose object can be anywhere" if starts == "wide" else ""
        raise InputError(f"{env.name} has no {starts} starts{reason}")
    return start


def starts_of(env: Env, start: str | Callable, pairs: str) -> Callable[[jax.Array, int], State]:
    """Return the function `(key, episodes) -> State`, leaves [episodes, ...], of the starts of an evaluation.

    `start` is a distribution of `env` by name, or a function `start(key) -> State`.

    Raises:
        ValueError: `pairs` is unknown, or balanced with other starts than `initial`, or as `start_of`.
    """
    require_known("pairs", pairs, EVAL_PAIRS)
    draw = start if callable(start) else start_of(env, start)
    if pairs == EVAL_PAIRS[0]:
        return lambda key, episodes: jax.vmap(draw)(jax.random.split(key, episodes))
    if start != STARTS[0]:
        given = "a function's" if callable(start) else start
        raise InputError(f"{pairs} pairs need the task's own starts (initial), not {given} ones")
    return functools.partial(balanced_starts, env)


@package_types()
def balanced_starts(env: Env, key: jax.Array, episodes: int) -> State:
    """Return starts, leaves [episodes, ...], that use every pair of start and task goal equally often.

    A pair is a start of `Starts.numbered` and a goal of `goal_states`; a task's other random values are drawn for each
    episode. If `episodes` is not a multiple of the number of pairs, some pairs, chosen at random, are used once more.
    """
    goals, listed = jnp.asarray(env.goal_states), env.starts
    pairs = listed.count * len(goals)
    order = jax.random.permutation(jax.random.fold_in(key, PAIR_KEY), pairs)

    def start(key: jax.Array, pair: jax.Array) -> State:
        state = env.reset(key) if listed.numbered is None else listed.numbered(key, pair // len(goals))
        return env.with_goal(state, goals[pair % len(goals)])

    return jax.vmap(start)(jax.random.split(key, episodes), order[jnp.arange(episodes) % pairs])
