"""The distributions of starts of an evaluation, by name."""

from collections.abc import Callable

import jax

from earl_jax.envs.base import Env
from earl_jax.envs.state import State
from earl_jax.errors import InputError

STARTS = ("initial", "uniform", "wide")
"""s0 ~ rho, uniform over the workspace (figure 4 of the paper), and the starts of `deployed/success_wide`."""


def start_of(env: Env, starts: str) -> Callable[[jax.Array], State]:
    """Return the function `start(key) -> State` of the distribution `starts` of `env`.

    Raises:
        ValueError: the name is unknown, or the task has no such starts.
    """
    if starts not in STARTS:
        raise InputError(f"unknown starts {starts!r}; choose from {', '.join(STARTS)}")
    if starts == "initial":
        return env.reset
    start = env.starts.wide if starts == "wide" else env.starts.uniform
    if start is None:
        reason = ": they belong to sparse tasks whose object can be anywhere" if starts == "wide" else ""
        raise InputError(f"{env.name} has no {starts} starts{reason}")
    return start
