"""Many training steps in one scan, whose keys and batches are drawn ahead of the steps that need them."""

import math

import jax
import jax.numpy as jnp

from earl_jax.algos.learner.replay import sample_own
from earl_jax.algos.method import Method, controller_count
from earl_jax.envs.checks import require_like
from earl_jax.envs.state import tree_where
from earl_jax.physics import PendingStep
from earl_jax.training.loop import finish, sample, start, store, train_step, update
from earl_jax.training.ordering import in_step_with_host, read_before_write
from earl_jax.training.state import Problem, StepKeys, TrainState, Warmup, step_keys


def run_steps(problem: Problem, method: Method, state: TrainState, steps: int, warmup: Warmup = False) -> TrainState:
    """Return all lanes after `steps` steps in one scan.

    k calls of whole blocks equal one call with k times the steps, bit for bit. A method's `refresh` runs at the start
    of every block. A block has `refresh_every` steps, or the greatest common divisor of that number and `steps` if it
    is smaller.
    """
    if method.refresh_every == 0 or warmup is True:
        return _run_block(problem, method, state, steps, warmup)
    block = math.gcd(method.refresh_every, steps)

    def refreshed_block(carry, _):
        refreshed = refresh(problem, method, carry)
        refreshed = refreshed.replace(lanes=tree_where(warmup, carry.lanes, refreshed.lanes))
        return _run_block(problem, method, refreshed, block, warmup), None

    return jax.lax.scan(refreshed_block, state, length=steps // block)[0]


def _run_block(problem: Problem, method: Method, state: TrainState, steps: int, warmup: Warmup) -> TrainState:
    """Return all lanes after `steps` steps in one scan, whose random keys are computed before it."""
    numbers = state.step + jnp.arange(steps + 1)
    keys = jax.vmap(lambda number: jax.vmap(step_keys, (0, None))(state.lanes.key, number))(numbers)
    now, following = jax.tree.map(lambda leaf: leaf[:-1], keys), keys.sample[1:]

    if warmup is not True and host_simulates(problem, state):
        return _start_ahead(problem, method, state, now, warmup)

    def step(carry, keys):
        return train_step(problem, method, carry, keys, warmup), None

    def step_and_draw(carry, keys):
        (state, batch), (now, following) = carry, keys
        return sample(method, train_step(problem, method, state, now, warmup, batch), following), None

    if warmup is not True and _draws_ahead():
        (state, _), _ = jax.lax.scan(step_and_draw, sample(method, state, keys.sample[0]), (now, following))
        return state
    return jax.lax.scan(step, state, now)[0]


def _start_ahead(problem: Problem, method: Method, state: TrainState, keys: StepKeys, warmup: Warmup) -> TrainState:
    """Return all lanes after the steps of `keys`, in a scan that starts each step before it stores the last one.

    The host waits for the start of a step. Everything after the start, including the draw of the step's batch, is
    computed while the host simulates.
    """

    def step(carry, keys):
        (state, started), (now, following) = carry, keys
        state, started = update(problem, method, state, started, now, warmup)
        lanes, stored = finish(problem, method, state, started, now)
        started = start(problem, method, lanes, following, warmup, state.step + 1)
        pending, stored = in_step_with_host(started.pending, stored)
        return (store(state, lanes, stored), started._replace(pending=pending)), None

    def part(index):
        return jax.tree.map(lambda leaf: leaf[index], keys)

    started = start(problem, method, state.lanes, part(0), warmup, state.step)
    pairs = part(slice(None, -1)), part(slice(1, None))
    (state, started), _ = jax.lax.scan(step, (state, started), pairs)
    state, started = update(problem, method, state, started, part(-1), warmup)
    return store(state, *finish(problem, method, state, started, part(-1)))


def _draws_ahead() -> bool:
    """Return whether a step draws the batch of the next step, as an accelerator can while it learns from its own batch.

    A CPU would do one after the other.
    """
    return jax.default_backend() != "cpu"


def host_simulates(problem: Problem, state: TrainState) -> bool:
    """Return whether the host simulates the control steps of `state` while the device computes."""
    env_states = state.lanes.env_state
    actions = jax.ShapeDtypeStruct((len(env_states.obs), problem.env.action_size), jnp.float32)
    pending: PendingStep = jax.eval_shape(jax.vmap(problem.env.start_step), env_states, actions)
    return pending.ticket is not None


def refresh(problem: Problem, method: Method, state: TrainState) -> TrainState:
    """Return the state after `Method.refresh` of every lane, with own transitions of the last controller."""
    batch = None
    if method.refresh_batch_size:
        keys = jax.vmap(lambda key: jax.random.fold_in(jax.random.fold_in(key, state.step), 2))(state.lanes.key)
        batch = sample_own(state.replay, keys, controller_count(method) - 1, method.refresh_batch_size)
        state, batch = read_before_write(state, batch)

    def refresh_lane(m, lane, batch):
        key = jax.random.fold_in(jax.random.fold_in(lane.key, state.step), 1)
        return m.refresh(key, problem.env, problem.goals, lane.agent, batch, lane.method_state)

    refreshed = jax.vmap(refresh_lane)(method, state.lanes, batch)
    require_like(f"{method.name}: refresh must return method_state", refreshed, state.lanes.method_state)
    return state.replace(lanes=state.lanes.replace(method_state=refreshed))
