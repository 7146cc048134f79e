"""Checks of a task before it is used: its goals, and the results of its functions of an observation."""

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.envs.state import State
from earl_jax.errors import InputError, brief

if TYPE_CHECKING:
    from earl_jax.envs.base import Env


@functools.cache
def check_task(env: "Env") -> None:
    """Check the goals of `env` and its functions of `obs`.

    Raises:
        ValueError: the rows of `goal_states` and `initial_states` are not finite or differ in length, `success` or
            `reward` returns a wrong shape or type, a sparse reward is not the success bit, or a state at its goal is
            not a success.
    """
    tables = {name: getattr(env, name) for name in ("goal_states", "initial_states")}
    for name, table in tables.items():
        is_table = isinstance(table, np.ndarray) and table.ndim == 2 and table.dtype.kind in "fiu" and len(table)
        if not is_table or not np.isfinite(table).all():
            raise InputError(
                f"{env.name}: {name} must be a NumPy array with rows of finite numbers, not {brief(table)}"
            )
    if len({table.shape[1] for table in tables.values()}) > 1:
        shapes = " and ".join(f"{name} {list(table.shape)}" for name, table in tables.items())
        raise InputError(f"{env.name}: rows of goals and initial states must have one length, not {shapes}")
    goals, are_states = env.goal_states, env.goal_size == env.state_size
    states = np.full((len(goals), env.state_size), 0.5)
    if are_states:
        states, goals = np.concatenate([states, goals]), np.tile(goals, (2, 1))
    obs = np.concatenate([states, goals], axis=1, dtype=np.float32)[None]
    for name, kind in (("success", "bool"), ("reward", "number")):
        result = jax.eval_shape(getattr(env, name), obs)
        require_result(f"{env.name}: {name} of obs {list(obs.shape)}", result, obs.shape[:2], kind)
    with jax.ensure_compile_time_eval():  # a user's program may make its problem while it is traced
        given = jnp.asarray(obs)
        bits = np.asarray(env.success(given))
        rewards = np.asarray(env.reward(given)) if env.sparse else bits
    if (bits != rewards).any():
        pair = f"reward is {brief(rewards)} where success is {brief(bits)}"
        raise InputError(f"{env.name}: a sparse reward is the success bit, but {pair}; or use reward_type='dense'")
    if are_states and not bits[0, len(env.goal_states) :].all():
        raise InputError(f"{env.name}: a state that equals its goal must be a success, but success is {brief(bits)}")


def of_whole_obs(function: Callable[[Any, jax.Array], jax.Array]) -> Callable[[Any, jax.Array], jax.Array]:
    """Return the `function` of a task and its `obs [..., s + g]` with a check that refuses a state without its goal."""

    @functools.wraps(function)
    def checked(env: Any, obs: jax.Array) -> jax.Array:
        if (shape := np.shape(obs))[-1:] != (env.observation_size,):
            raise InputError(
                f"{env.name}: {function.__name__} takes obs [..., {env.observation_size}], a state with its goal, not "
                f"{list(shape)}"
            )
        return function(env, obs)

    return checked


def of_state(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return the `reset` of a task with a check that refuses a result that is no `State`, such as (obs, state)."""

    @functools.wraps(function)
    def checked(env: Any, key: jax.Array) -> State:
        if not isinstance(state := function(env, key), State):
            raise InputError(f"{env.name}: reset must return a State, from make_state, not {brief(state)}")
        return state

    return checked


def require_tuple(what: str, result: Any, kind: Any, *names: str) -> Any:
    """Return `result` of the function `what`; an InputError unless it is a named tuple `kind` or a tuple of `names`."""
    if not isinstance(result, kind) or (names and len(result) != len(names)):
        wanted = f"({', '.join(names)})" if names else f"{kind.__name__}({', '.join(kind._fields)})"
        given = f"a tuple of {len(result)}" if isinstance(result, tuple) else f"an object of {type(result).__name__}"
        raise InputError(f"{what} must return {wanted}, not {given}")
    return result


def require_result(what: str, result: Any, shape: tuple[int, ...], kind: str) -> None:
    """Raise an InputError that names `what` unless `result` has this `shape` and kind: `bool`, `index` or `number`."""
    try:
        given = jax.typeof(result)
    except TypeError as error:  # such as None, of a function without a return
        raise InputError(f"{what} must be {kind}{list(shape)}, not {brief(result)}") from error
    kinds = {"bool": jnp.bool_, "index": jnp.integer, "number": jnp.generic}
    if given.shape != shape or not jnp.issubdtype(given.dtype, kinds[kind]):
        raise InputError(f"{what} must be {kind}{list(shape)}, not {given.dtype}{list(given.shape)}")


def first_difference(before: dict[str, str], after: dict[str, str]) -> tuple[str, str, str]:
    """Return the name and the texts of the first entry in which the two differ; `missing` where one has none."""
    name, _ = min(before.items() ^ after.items())
    return name, before.get(name, "missing"), after.get(name, "missing")


def require_like(what: str, result: Any, given: Any) -> None:
    """Raise an InputError about `what` unless the leaves of `result` have the names, shapes and types of `given`."""
    before, after = (
        {jax.tree_util.keystr(path): f"{jnp.result_type(leaf)}{list(jnp.shape(leaf))}" for path, leaf in leaves}
        for leaves in map(jax.tree.leaves_with_path, (given, result))
    )
    if before != after:
        name, was, now = first_difference(before, after)
        raise InputError(f"{what} with the same leaves, but {name or 'it'} was {was} and is {now}")
