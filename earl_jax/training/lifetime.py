"""A whole lifetime as a pure function, for `jit`, `vmap` or a notebook."""

import numbers

import jax
import jax.numpy as jnp

from earl_jax.algos.method import Method, check_method
from earl_jax.errors import InputError
from earl_jax.options.jax_settings import package_types
from earl_jax.options.values import COUNT, require, require_object
from earl_jax.training.evaluation import evaluate_lanes
from earl_jax.training.init import init_train_state
from earl_jax.training.plan import Plan, make_plan, per_lane
from earl_jax.training.scan import run_steps
from earl_jax.training.state import Problem, TrainState


@package_types()
def lifetime(
    problem: Problem, method: Method, keys: jax.Array, steps: int | None = None
) -> tuple[TrainState, dict[str, jax.Array]]:
    """Return the final train state and the metrics [N, E] of lifetimes of `steps` steps, without side effects.

    `jax.jit(lifetime)(problem, method, keys)` is one program for each problem.

    Args:
        problem: the environment, its protocol, and the steps (static).
        method: the method, with scalar leaves or leaves [N].
        keys: typed PRNG keys [N], one for each seed.
        steps: training steps, a multiple of the protocol's `eval_every`; by default those of the problem. Under `jit`
            it is a static argument.

    Raises:
        ValueError: `problem` or `method` is another object, such as a name; `steps` is missing, traced or inconsistent
            with the protocol; `keys` does not have exactly one axis; or `check_method` or `make_plan` raises it.
    """
    require_object("problem", problem, Problem, or_name=False)
    require_object("method", method, Method, or_name=False)
    check_method(method)
    steps = _static_steps(problem, steps)
    if jax.random.key_data(keys).ndim != 2:
        raise InputError("keys must have one axis, a key for each seed: jax.random.split(key, number)")
    lanes, every = keys.shape[0], problem.protocol.eval_every
    method = per_lane(method, lanes)
    plan = make_plan(problem, method, lanes, steps)
    state = init_train_state(problem, method, keys, steps)
    state, metrics = jax.lax.scan(lambda state, _: _window(plan, method, state), state, length=steps // every)
    return state, jax.tree.map(jnp.transpose, metrics)


def _static_steps(problem: Problem, steps: int | None) -> int:
    """Return `steps`, by default those of `problem`. Errors as `lifetime`."""
    steps = problem.steps if steps is None else steps
    if steps is None:
        raise InputError("a lifetime needs a number of steps: Problem(env, protocol, steps=...)")
    if not isinstance(steps, numbers.Integral):
        raise InputError(
            "the steps of a lifetime are a whole number, and static under jit: use Problem(env, protocol, steps=...), or "
            'jax.jit(lifetime, static_argnames="steps")'
        )
    require("steps", steps, COUNT)
    return steps


def _window(plan: Plan, method: Method, state: TrainState) -> tuple[TrainState, dict[str, jax.Array]]:
    """Return the state after the next evaluation, and its metrics [N].

    Warm-up steps and learning steps share one piece of the program, because XLA takes seconds to compile the physics of
    each piece on MJX.
    """
    chunks = plan.problem.protocol.eval_every // plan.chunk_steps

    def chunk(carry, _):
        has_both = 0 < plan.random_steps < plan.steps
        warmup = carry.step < plan.random_steps if has_both else plan.random_steps > 0
        return run_steps(plan.problem, method, carry, plan.chunk_steps, warmup), None

    return evaluate_lanes(plan.problem, method, jax.lax.scan(chunk, state, length=chunks)[0])
