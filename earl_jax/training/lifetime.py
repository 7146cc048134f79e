"""A whole lifetime as a pure function, for `jit`, `vmap` or a notebook."""

import numbers

import jax
import jax.numpy as jnp

from earl_jax.algos import Method
from earl_jax.errors import InputError
from earl_jax.training.evaluation import evaluate_lanes
from earl_jax.training.init import init_train_state
from earl_jax.training.plan import Plan, Span, per_lane, prepare
from earl_jax.training.scan import run_steps
from earl_jax.training.state import Problem, TrainState


def lifetime(
    problem: Problem, method: Method, keys: jax.Array, steps: int | None = None
) -> tuple[TrainState, dict[str, jax.Array]]:
    """Return the final train state and the metrics [N, E] of whole lifetimes of `steps` steps, without side effects.

    `jax.jit(lifetime)(problem, method, keys)` is one program for each problem.

    Args:
        problem: the environment, its protocol, and the steps (static).
        method: the method, with scalar leaves or leaves [N].
        keys: typed PRNG keys [N], one for each seed.
        steps: training steps, a multiple of the protocol's `eval_every`; by default those of the problem. Under `jit`
            it is a static argument.

    Raises:
        ValueError: `steps` and the protocol are inconsistent, there are no steps, they are traced, or as `prepare`.
    """
    steps = _static_steps(problem, steps)
    lanes, every = keys.shape[0], problem.protocol.eval_every
    method = per_lane(method, lanes)
    plan = prepare(problem, method, lanes, steps)
    state = init_train_state(problem, method, keys, plan.capacity)
    explored = -(-min(plan.random_steps, steps) // every) * every
    early = []
    for start in range(0, explored, every):
        state, metrics = _window(plan, method, state, start)
        early.append(metrics)
    state, rest = jax.lax.scan(
        lambda carry, _: _window(plan, method, carry, explored), state, length=(steps - explored) // every
    )
    curves = [jax.tree.map(lambda *rows: jnp.stack(rows), *early), rest] if early else [rest]
    return state, jax.tree.map(lambda *parts: jnp.concatenate(parts).T, *curves)


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
    return steps


def _window(plan: Plan, method: Method, state: TrainState, start: int) -> tuple[TrainState, dict[str, jax.Array]]:
    """Return the state after the steps from `start` to the next evaluation, and its metrics [N]."""
    for span in plan.spans(start):
        state = _scan_chunks(plan, method, state, span)
    return evaluate_lanes(plan.problem, method, state)


def _scan_chunks(plan: Plan, method: Method, state: TrainState, span: Span) -> TrainState:
    def body(carry, _):
        return run_steps(plan.problem, method, carry, plan.chunk, span.explore), None

    return jax.lax.scan(body, state, length=span.chunks)[0]
