"""The one reset-free training step, for every method and all lanes at once.

The order is `start -> update -> finish -> store`, and for one lane `act -> env.start_step -> learn(prepare(sample)) ->
env.finish_step -> rules`. `start` vmaps `start_lane`, and so on. Between them the replay is read and written unbatched,
because it is one buffer. The gradient step of a control step samples only transitions stored before it, so that the
host can simulate while the accelerator learns. The released code has the same delay, due to a prefetched dataset.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from earl_jax.algos.goals import GoalIndices
from earl_jax.algos.learner import replay as replay_lib
from earl_jax.algos.learner.base import Batch
from earl_jax.algos.learner.replay import Transition, TransitionBatch, TransitionFlags
from earl_jax.algos.method import (
    TASK,
    Method,
    Moment,
    controller_count,
    controller_of,
    of_phase,
    select_controller,
)
from earl_jax.envs import State
from earl_jax.envs.checks import require_like, require_result, require_tuple
from earl_jax.envs.state import tree_where
from earl_jax.physics import PendingStep
from earl_jax.protocol import Attempt, StepEnd, advance_rules, count_step, reset_where
from earl_jax.training.demos import used_demos
from earl_jax.training.ordering import before_update, in_step_with_host, one_controller, read_before_write
from earl_jax.training.state import LaneState, Problem, StepKeys, TrainState, Warmup, count_visit


class Started(NamedTuple):
    """The control steps that all lanes have started: their actions [N, a], and what `Env.finish_step` needs."""

    action: jax.Array
    pending: PendingStep


Stored = tuple[Transition, jax.Array, jax.Array]
"""What the replay stores for one step of all lanes: the last arguments of `replay.write`."""


def train_step(
    problem: Problem,
    method: Method,
    state: TrainState,
    keys: StepKeys,
    warmup: Warmup,
    batch: TransitionBatch | None = None,
) -> TrainState:
    """Return all lanes one step later: act, store and, unless `warmup`, make a gradient step on earlier transitions.

    The float leaves of `method` and the `keys` have a leading lane axis. `batch` contains the transitions of `sample`;
    if it is None, they are drawn here.
    """
    started = start(problem, method, state.lanes, keys, warmup, state.step)
    if warmup is not True:
        state, started = update(problem, method, state, started, keys, warmup, batch)
    return store(state, *finish(problem, method, state, started, keys))


def start(
    problem: Problem, method: Method, lanes: LaneState, keys: StepKeys, warmup: Warmup, step: jax.Array
) -> Started:
    """Return the control steps that the `lanes` start at `step []`, with their actions."""
    of_lane = jax.vmap(lambda m, lane, key: start_lane(problem, m, lane, key, warmup, step))
    return Started(*of_lane(method, lanes, keys.act))


def update(
    problem: Problem,
    method: Method,
    state: TrainState,
    started: Started,
    keys: StepKeys,
    warmup: Warmup,
    batch: TransitionBatch | None = None,
) -> tuple[TrainState, Started]:
    """Return the state after a gradient step of each lane, and the `started` steps, to be finished afterwards."""
    if batch is None:
        state, batch = sample(method, state, keys.sample)
    of_lane = jax.vmap(lambda m, lane, key, rows: update_lane(problem, m, lane, key, rows, state.step))
    pending, lanes = in_step_with_host(started.pending, of_lane(method, state.lanes, keys, batch))
    if not (method.learner.random_steps or used_demos(problem.env, method)):  # the replay is empty at first
        lanes = jax.vmap(tree_where)(state.replay.counts.any(axis=1), lanes, state.lanes)
    return state.replace(lanes=tree_where(warmup, state.lanes, lanes)), started._replace(pending=pending)


def finish(
    problem: Problem, method: Method, state: TrainState, started: Started, keys: StepKeys
) -> tuple[LaneState, Stored]:
    """Return the lanes of `state` after the steps that they have `started`, and what the replay stores for them."""
    controller = controller_of(method, state.lanes.phase)
    of_lane = jax.vmap(lambda m, lane, *moved: finish_lane(problem, m, lane, *moved, step=state.step))
    lanes, transition, sampleable = of_lane(method, state.lanes, *started, keys)
    return lanes, (transition, sampleable, controller)


def store(state: TrainState, lanes: LaneState, stored: Stored) -> TrainState:
    """Return the state one step later, with the `lanes` and the `stored` transitions that `finish` returned."""
    return TrainState(lanes, replay_lib.write(state.replay, *stored), state.step + 1)


@jax.named_scope("act")
def start_lane(
    problem: Problem, method: Method, lane: LaneState, key: jax.Array, warmup: Warmup, step: jax.Array
) -> tuple[jax.Array, PendingStep]:
    """Return the action [a] of one lane, uniformly random during the `warmup`, and the step that it starts."""
    action = jax.random.uniform(key, (problem.env.action_size,), minval=-1.0, maxval=1.0)
    if warmup is not True:
        stacked, controller = before_update((lane.agent.actor, controller_of(method, lane.phase)))
        actor = before_update(select_controller(stacked, controller))
        chosen = method.act(key, problem.env, actor, lane.env_state.obs, _moment(lane, step), lane.method_state)
        chosen = jnp.asarray(chosen, jnp.float32)
        require_result(f"{method.name}: the action from act", chosen, action.shape, "number")
        chosen = jnp.clip(chosen, -1.0, 1.0)  # as `start_step` does, so that the replay has what was done
        action = jnp.where(warmup, action, chosen)
    return action, problem.env.start_step(lane.env_state, action)


def sample(method: Method, state: TrainState, keys: jax.Array) -> tuple[TrainState, TransitionBatch]:
    """Return the state and the transitions from which each lane learns in its next step, drawn with `keys [N]`."""
    learner, controller = method.learner, controller_of(method, state.lanes.phase)
    demo_share, size = jnp.asarray(learner.demo_share), learner.batch_size * learner.utd
    only_own = state.replay.evicts and not learner.keep_demos and state.step >= state.replay.kept
    batch = replay_lib.sample(state.replay, keys, controller, size, demo_share, method.later_steps, only_own)
    return read_before_write(state, batch)


@jax.named_scope("update")
def update_lane(
    problem: Problem, method: Method, lane: LaneState, keys: StepKeys, sampled: TransitionBatch, step: jax.Array
) -> LaneState:
    """Return the lane after an update of the controller that acts at `step []`, from 0, on `sampled` transitions [B].

    After the end of the lifetime, the lane stays as it is.
    """
    env, phase = problem.env, lane.phase
    sampled = method.prepare(keys.prepare, env, problem.goals, sampled, phase, lane.method_state)
    batch, controller = batch_of(problem, method, sampled, step), controller_of(method, phase)
    agent = select_controller(lane.agent, controller)
    learnt = method.learn(keys.learn, env, agent, batch, phase, lane.method_state)
    known = (agent, lane.method_state, lane.counters.diagnostics)
    require_like(f"{method.name}: learn must return (agent, method_state, Learner.diagnostics)", learnt, known)
    agent, method_state, diagnostics = learnt
    agent = _with_controller(lane.agent, one_controller(agent, controller_count(method)), controller)
    counters = lane.counters.replace(diagnostics=diagnostics)
    updated = lane.replace(agent=agent, method_state=method_state, counters=counters)
    return tree_where(lane.env_state.done > 0, lane, updated) if env.has_absorbing_state else updated


def batch_of(problem: Problem, method: Method, sampled: TransitionBatch, step: jax.Array) -> Batch:
    """Return the transitions that `prepare` returned as the learner receives them; an InputError if they are invalid."""
    require_tuple(f"{method.name}: prepare", sampled, TransitionBatch)
    env, flags, size = problem.env, sampled.flags, sampled.action.shape[:1]
    goal = jnp.asarray(problem.goals.table)[flags.goal] if sampled.goal is None else sampled.goal
    require_result(f"{method.name}: the goal from prepare", goal, (*size, env.goal_size), "number")
    cut_off = flags.timeout & ~jnp.asarray(method.learner.timeout_bootstrap, bool)
    batch = Batch(
        obs=jnp.concatenate([sampled.state, goal], axis=-1),
        action=sampled.action,
        reward=sampled.reward,
        terminal=flags.reached | flags.absorbed | cut_off,
        next_obs=jnp.concatenate([sampled.next_state, goal], axis=-1),
        demonstrated=sampled.demonstrated,
        step=step,
    )
    for name, shape in {"obs": (*size, env.observation_size), "reward": size, "terminal": size}.items():
        require_result(f"{method.name}: the {name} from prepare", getattr(batch, name), shape, "number")
    return batch


@jax.named_scope("physics")
def finish_lane(
    problem: Problem,
    method: Method,
    lane: LaneState,
    action: jax.Array,
    pending: PendingStep,
    keys: StepKeys,
    step: jax.Array,
) -> tuple[LaneState, Transition, jax.Array]:
    """Return the lane after its `pending` step number `step` (from 0), the transition, and if that can be sampled."""
    env, table = problem.env, jnp.asarray(problem.goals.table)
    env_state = env.finish_step(lane.env_state, pending)
    earned = env.goal_reward(env_state, table[lane.goal_indices.task])
    attempt = _attempt(problem, method, lane, earned, keys.reset, step)
    end = advance_rules(lane.rules, env, env_state, attempt, step + 1, keys.chance)
    phase = jnp.where(end.phase_ended, (lane.phase + 1) % len(method.phases), lane.phase)
    phase = jnp.where(end.task_restarts, TASK, phase)
    goal_indices = _next_goals(problem, method, lane, phase, keys.goal, end)
    following = env.with_goal(reset_where(end.env_reset, env, keys.reset, env_state), table[goal_indices.goal])
    transition = _transition(problem, lane, action, env_state, following, end)
    moved = lane.replace(
        env_state=following,
        phase=phase,
        phase_step=jnp.where(end.phase_ended, 0, lane.phase_step + 1),
        goal_indices=goal_indices,
        counters=count_step(lane.counters, env, env_state, attempt, end, earned, step + 1),
        visits=count_visit(env, lane, env_state.obs),
    )
    return moved, transition, _is_sampleable(method, lane, end)


def _attempt(
    problem: Problem, method: Method, lane: LaneState, earned: jax.Array, key: jax.Array, step: jax.Array
) -> Attempt:
    """Return the attempt to which a step with the task reward `earned []` belongs."""
    key, moment = jax.random.fold_in(key, 2), _moment(lane, step)
    expires = method.ends_phase(key, problem.env, lane.agent, lane.env_state.obs, moment, lane.method_state)
    require_result(f"{method.name}: what ends_phase returns", expires, (), "bool")
    return Attempt(
        is_task=lane.phase == TASK,
        expires=expires,
        ends_on_success=of_phase([phase.ends_on_success for phase in method.phases], lane.phase),
        reset_at_end=of_phase([phase.resets for phase in method.phases], lane.phase),
        invalid_reward=~jnp.isfinite(earned),
        has_goal=of_phase([phase.has_goal for phase in method.phases], lane.phase),
        age=lane.phase_step,
    )


def _transition(
    problem: Problem, lane: LaneState, action: jax.Array, env_state: State, following: State, end: StepEnd
) -> Transition:
    """Return the transition that the replay stores for a step to `env_state`; training continues from `following`."""
    flags = TransitionFlags(
        goal=lane.goal_indices.goal,
        reached=end.reached,
        timeout=end.timeout,
        no_successor=end.env_reset,
        absorbed=env_state.done > 0,
        passed=end.passed,
    )
    reward = jnp.where(end.fault, 0.0, env_state.reward)
    return Transition(action, following.obs[: problem.env.state_size], reward, flags)


def _is_sampleable(method: Method, lane: LaneState, end: StepEnd) -> jax.Array:
    """Return whether a transition can be sampled, bool [].

    It cannot after a fault or after the end of the lifetime, nor if its target needs a successor that was not stored.
    """
    bootstrapped = end.timeout & jnp.asarray(method.learner.timeout_bootstrap, bool)
    return ~(end.env_reset & bootstrapped) & ~end.fault & ~(lane.env_state.done > 0)


def _next_goals(
    problem: Problem, method: Method, lane: LaneState, phase: jax.Array, key: jax.Array, end: StepEnd
) -> GoalIndices:
    """Return the goals after a step; in the continuing setting, the method can only draw the environment's task goal."""
    is_continuing = lane.rules.goal_change > 0
    drawn = problem.goals.draw_task(jax.random.fold_in(key, 1))
    task = jnp.where(end.goal_changes, drawn, lane.goal_indices.task)
    goals = problem.goals._replace(requested=jnp.where(is_continuing, task, -1))
    current = lane.goal_indices._replace(task=task)
    fresh = method.next_goal(key, goals, phase, current, lane.method_state)
    goal_indices = tree_where(end.phase_ended, fresh, lane.goal_indices)
    goal_indices = goal_indices._replace(task=jnp.where(is_continuing, task, goal_indices.task))
    return tree_where(goals.lacks(lane.goal_indices), lane.goal_indices, goal_indices)  # `check_lanes` reports them


def _moment(lane: LaneState, step: jax.Array) -> Moment:
    return Moment(step, lane.phase, lane.phase_step, lane.key)


def _with_controller(stacked: Any, single: Any, index: jax.Array) -> Any:
    """Return the `stacked` tree with one controller replaced, by a select: XLA makes loops or kernels of scatters."""

    def put(leaf, value):
        chosen = jnp.arange(len(leaf)).reshape(-1, *[1] * value.ndim) == index
        return value[None] if len(leaf) == 1 else jnp.where(chosen, value[None], leaf)

    return jax.tree.map(put, stacked, single)
