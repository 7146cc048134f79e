"""The one reset-free training step: act, step, store, sample, update, for every method and all lanes at once.

`act_and_start`, `update` and `finish_and_store` are written for one lane and vmapped. Between them the replay is read
and written unbatched, because it is one buffer. The gradient step of a control step samples transitions that were
stored before it, so that the host can simulate while the accelerator learns. The released code has the same delay, due
to a prefetched dataset.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.algos.goals import GoalIndices
from earl_jax.algos.learner import replay as replay_lib
from earl_jax.algos.learner import sac
from earl_jax.algos.learner.replay import Transition, TransitionBatch, TransitionFlags
from earl_jax.algos.method import TASK, Method
from earl_jax.envs.state import tree_where
from earl_jax.metrics.phase_stats import advance_phase_stats
from earl_jax.physics import PendingStep
from earl_jax.protocol import Attempt, StepEnd, advance_rules, reset_where
from earl_jax.training.ordering import after
from earl_jax.training.state import MAP_BINS, LaneState, Problem, StepKeys, TrainState, Warmup


def train_step(
    problem: Problem,
    method: Method,
    state: TrainState,
    keys: StepKeys,
    warmup: Warmup = False,
    batch: TransitionBatch | None = None,
) -> TrainState:
    """Return all lanes one step later: act, store and, unless `warmup`, take a gradient step on earlier transitions.

    The float leaves of `method` and the `keys` have a leading lane axis. `batch` are the transitions of `sample`, which
    are drawn here if they are not given.
    """
    lanes = state.lanes
    controller = controller_of(method, lanes.phase)
    act = jax.vmap(lambda m, lane, key: act_and_start(problem, m, lane, key, warmup, state.step))
    action, pending = act(method, lanes, keys.act)
    if warmup is not True:
        if pending.ticket is not None:  # the host starts before the device draws a batch and learns
            ticket, lanes, keys = jax.lax.optimization_barrier((pending.ticket, lanes, keys))
            pending = pending._replace(ticket=ticket)
        if batch is None:
            state, batch = sample(method, state.replace(lanes=lanes), keys.sample)
        update_lane = functools.partial(update, problem, first_row=state.replay.first_row, step=state.step)
        updated = jax.vmap(update_lane)(method, lanes, keys, batch, lanes.phase)
        updated = _unless_ended(lanes, updated) if problem.env.has_absorbing_state else updated
        lanes = updated if warmup is False else _unless_warmup(warmup, lanes, updated)
        if pending.ticket is not None:  # the device learns before it waits for the host
            ticket, lanes = jax.lax.optimization_barrier((pending.ticket, lanes))
            pending = pending._replace(ticket=ticket)
    finish = jax.vmap(lambda m, *lane: finish_and_store(problem, m, *lane, step=state.step))
    lanes, transition, listed = finish(method, lanes, action, pending, keys)
    return TrainState(lanes, replay_lib.write(state.replay, transition, listed, controller), state.step + 1)


def sample(method: Method, state: TrainState, keys: jax.Array) -> tuple[TrainState, TransitionBatch]:
    """Return the state and the transitions from which each lane learns in its next step, drawn with `keys [N]`."""
    controller = controller_of(method, state.lanes.phase)
    demo_share, size = jnp.asarray(method.sac.demo_share), method.sac.batch_size * method.sac.utd
    batch = replay_lib.sample(state.replay, keys, controller, size, demo_share, method.later_steps)
    return _read_before_write(state, batch)


def sample_own(method: Method, state: TrainState) -> tuple[TrainState, TransitionBatch]:
    """Return the state and `own_rows` transitions of each lane's last controller, its own, for `refresh`."""
    keys = jax.vmap(lambda key: jax.random.fold_in(jax.random.fold_in(key, state.step), 2))(state.lanes.key)
    batch = replay_lib.sample_own(state.replay, keys, method.controllers - 1, method.own_rows)
    return _read_before_write(state, batch)


def _read_before_write(state: TrainState, batch: TransitionBatch) -> tuple[TrainState, TransitionBatch]:
    """Return the state that the next write can use once `batch` is read; else XLA copies the whole buffer before it."""
    batch = jax.lax.optimization_barrier(batch)
    row = after(state.replay.row, batch)
    return state.replace(replay=state.replay.replace(row=row)), batch


@jax.named_scope("act")
def act_and_start(
    problem: Problem, method: Method, lane: LaneState, key: jax.Array, warmup: Warmup, step: jax.Array
) -> tuple[jax.Array, PendingStep]:
    """Return the action [a] of one lane, uniform with `warmup` or by the method's own word, and the step that it starts."""
    held = jax.random.fold_in(jax.random.fold_in(lane.key, step // method.explore_hold), 3)
    own = warmup is not True and method.explores(held, problem.env, lane.phase, lane.phase_step, lane.method_state)
    action = _act(problem, method, lane, key, warmup)
    if own is not False:
        action = jnp.where(own, _act(problem, method, lane, held, True), action)
    return action, problem.env.start_step(lane.env_state, action)


def _act(problem: Problem, method: Method, lane: LaneState, key: jax.Array, warmup: Warmup) -> jax.Array:
    size = problem.env.action_size
    if warmup is not False:
        uniform = jax.random.uniform(key, (size,), minval=-1.0, maxval=1.0)
        return uniform if warmup is True else jnp.where(warmup, uniform, _act(problem, method, lane, key, False))
    # Without barriers, XLA reads the actor in the kernels that update it, and so acts after the update.
    stacked, controller = jax.lax.optimization_barrier((lane.agent.actor, controller_of(method, lane.phase)))
    actor = jax.lax.optimization_barrier(_controller(stacked, controller))
    return sac.act(method.sac, actor, lane.env_state.obs, key, size)


@jax.named_scope("physics")
def finish_and_store(
    problem: Problem,
    method: Method,
    lane: LaneState,
    action: jax.Array,
    pending: PendingStep,
    keys: StepKeys,
    step: jax.Array,
) -> tuple[LaneState, Transition, jax.Array]:
    """Return the lane after its `pending` control step, the transition, and whether the replay lists it, bool [].

    `step []` counts from 0.
    """
    env, table = problem.env, jnp.asarray(problem.goals.table)
    env_state = env.finish_step(lane.env_state, pending)
    earned = env.goal_reward(env_state, table[lane.goal_indices.task])
    end = _step_end(problem, method, lane, env_state, earned, keys, step)
    is_task, has_goal = lane.phase == TASK, jnp.asarray(method.ends_on_success(lane.phase), bool)
    phases = advance_phase_stats(
        lane.counters.phases, env, env_state, is_task, end.phase_ended & has_goal, end.reached, step + 1
    )
    counters = lane.counters.replace(
        phases=phases,
        window_reward=lane.counters.window_reward + jnp.where(end.fault, 0.0, earned),
        interventions=lane.counters.interventions + end.env_reset,
        faults=lane.counters.faults + end.fault,
        reached=lane.counters.reached + (end.reached & is_task),
    )
    phase = jnp.where(end.task_restarts, TASK, jnp.where(end.phase_ended, (lane.phase + 1) % method.phases, lane.phase))
    goal_indices = _next_goals(problem, method, lane, phase, keys.goal, end)
    following = env.with_goal(reset_where(end.env_reset, env, keys.reset, env_state), table[goal_indices.goal])
    transition = _transition(problem, method, lane, action, env_state, following, end)
    moved = lane.replace(
        env_state=following,
        phase=phase,
        phase_step=jnp.where(end.phase_ended, 0, lane.phase_step + 1),
        goal_indices=goal_indices,
        counters=counters,
        visits=None if lane.visits is None else _count_visit(problem, lane.visits, env_state.obs),
    )
    return moved, transition, _is_sampleable(method, lane, end)


def _step_end(
    problem: Problem,
    method: Method,
    lane: LaneState,
    env_state: Any,
    earned: jax.Array,
    keys: StepKeys,
    step: jax.Array,
) -> StepEnd:
    key, acting = jax.random.fold_in(keys.reset, 2), _controller(lane.agent, controller_of(method, lane.phase))
    switches = method.switches(
        key, problem.env, acting, lane.env_state.obs, lane.phase, lane.phase_step, lane.method_state
    )
    attempt = Attempt(
        is_task=lane.phase == TASK,
        age=method.phase_age(step, lane.phase_step),
        limit=method.phase_length(problem.env, lane.phase),
        ends_on_success=method.ends_on_success(lane.phase),
        reset_at_end=method.resets,
        invalid_reward=~jnp.isfinite(earned),
        given_up=switches,
    )
    return advance_rules(lane.rules, problem.env, env_state, attempt, step + 1, jax.random.fold_in(keys.reset, 1))


def _transition(
    problem: Problem, method: Method, lane: LaneState, action: jax.Array, env_state: Any, following: Any, end: StepEnd
) -> Transition:
    """Return the transition that the replay stores for a step to `env_state`; training continues from `following`."""
    absorbed = env_state.done > 0
    flags = TransitionFlags(
        goal=lane.goal_indices.goal,
        reached=end.reached,
        timeout=end.timeout,
        no_successor=end.env_reset,
        absorbed=absorbed,
    )
    effective_horizon = jnp.where(absorbed, 1.0 / (1.0 - method.sac.discount), 1.0)
    reward = jnp.where(end.fault, 0.0, env_state.reward * effective_horizon)
    return Transition(action, following.obs[: problem.env.state_size], reward, flags)


def _is_sampleable(method: Method, lane: LaneState, end: StepEnd) -> jax.Array:
    """Return whether a transition can be sampled, bool [].

    It cannot after a fault or after the end of the lifetime, or if its target needs a successor that was not stored.
    """
    bootstrapped = end.timeout & jnp.asarray(method.sac.timeout_bootstrap, bool)
    return ~(end.env_reset & bootstrapped) & ~end.fault & ~(lane.env_state.done > 0)


def _next_goals(
    problem: Problem, method: Method, lane: LaneState, phase: jax.Array, key: jax.Array, end: StepEnd
) -> GoalIndices:
    """Return the goals after a step; if the environment sets goals, the method can only draw that task goal."""
    env_sets = lane.rules.goal_change > 0
    drawn = problem.goals.draw_task(jax.random.fold_in(key, 1))
    requested = jnp.where(end.goal_changes, drawn, lane.goal_indices.task)
    goals = problem.goals._replace(requested=jnp.where(env_sets, requested, -1))
    current = lane.goal_indices._replace(task=requested)
    fresh = method.next_goal(key, goals, phase, current, lane.method_state)
    goal_indices = tree_where(end.phase_ended, fresh, lane.goal_indices)
    return goal_indices._replace(task=jnp.where(env_sets, requested, goal_indices.task))


def _count_visit(problem: Problem, visits: jax.Array, obs: jax.Array) -> jax.Array:
    low, high = np.asarray(problem.env.map_bounds)
    share = (problem.env.map_position(obs) - low) / (high - low)
    x, y = jnp.clip(jnp.floor(share * MAP_BINS), 0, MAP_BINS - 1).astype(jnp.int32)
    return visits.at[x, y].add(1)


@jax.named_scope("update")
def update(
    problem: Problem,
    method: Method,
    lane: LaneState,
    keys: StepKeys,
    sampled: TransitionBatch,
    phase: jax.Array,
    first_row: jax.Array,
    step: jax.Array,
) -> LaneState:
    """Return the lane after an update of the controller that acted in `phase`, on `sampled` transitions [B].

    Demonstrations are the rows before `first_row []`; `step []` counts from 0.
    """
    env, goals, table = problem.env, problem.goals, jnp.asarray(problem.goals.table)
    sampled = sampled._replace(demonstrated=sampled.row < first_row)
    sampled = method.relabel(keys.relabel, env, goals, sampled, phase)
    goal = table[sampled.flags.goal] if sampled.goal is None else sampled.goal
    batch = sac.Batch(
        obs=jnp.concatenate([sampled.state, goal], axis=-1),
        action=sampled.action,
        reward=method.reward(env, goals, sampled, phase, lane.method_state),
        terminal=method.terminal(sampled, phase),
        next_obs=jnp.concatenate([sampled.next_state, goal], axis=-1),
        demonstrated=sampled.demonstrated,
        step=step,
    )
    controller = controller_of(method, phase)
    agent, diagnostics = method.update_agent(keys.update, _controller(lane.agent, controller), batch)
    if method.controllers > 1:  # else XLA writes both controllers to new arrays, and copies them back
        agent = jax.lax.optimization_barrier(agent)
    state_key = jax.random.fold_in(keys.update, 2)
    return lane.replace(
        agent=_with_controller(lane.agent, agent, controller),
        method_state=method.update_state(state_key, env, goals, sampled, phase, lane.method_state),
        counters=lane.counters.replace(diagnostics=diagnostics),
    )


def controller_of(method: Method, phase: jax.Array) -> jax.Array:
    """Return the index of the controller that acts in `phase`; with one controller it is always 0."""
    return jnp.minimum(phase, method.controllers - 1)


def _controller(stacked: Any, index: jax.Array) -> Any:
    """Return one controller of a stacked tree; a stack of one needs no gather."""
    return jax.tree.map(lambda leaf: leaf[0] if leaf.shape[0] == 1 else leaf[index], stacked)


def _with_controller(stacked: Any, single: Any, index: jax.Array) -> Any:
    """Return the `stacked` tree with one controller replaced, by a select: XLA makes a loop or a kernel of each scatter."""

    def put(leaf, value):
        chosen = jnp.arange(len(leaf)).reshape(-1, *[1] * value.ndim) == index
        return value[None] if len(leaf) == 1 else jnp.where(chosen, value[None], leaf)

    return jax.tree.map(put, stacked, single)


def _unless_ended(lanes: LaneState, updated: LaneState) -> LaneState:
    """Return the `updated` lanes, with the old agent in lanes whose lifetime has ended: they no longer learn."""
    ended = lanes.env_state.done > 0

    def keep(old, new):
        return jnp.where(ended.reshape(-1, *[1] * (new.ndim - 1)), old, new)

    agent = jax.tree.map(keep, lanes.agent, updated.agent)
    return updated.replace(agent=agent, method_state=jax.tree.map(keep, lanes.method_state, updated.method_state))


def _unless_warmup(warmup: jax.Array, lanes: LaneState, updated: LaneState) -> LaneState:
    """Return the `updated` lanes, or the old learner of all `lanes` with `warmup`, bool []."""
    counters = updated.counters
    old = lanes.agent, lanes.method_state, lanes.counters.diagnostics
    kept = tree_where(warmup, old, (updated.agent, updated.method_state, counters.diagnostics))
    return updated.replace(agent=kept[0], method_state=kept[1], counters=counters.replace(diagnostics=kept[2]))
