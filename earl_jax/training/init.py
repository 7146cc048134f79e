"""The initial state of training: new agents, s0 ~ rho, and demonstrations as the first rows of the replay."""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.algos.goals import GoalIndices
from earl_jax.algos.learner import replay as replay_lib
from earl_jax.algos.learner.replay import Replay, TransitionFlags
from earl_jax.algos.method import TASK, Method, controller_count, kept_transitions
from earl_jax.envs.checks import require_like, require_result, require_tuple
from earl_jax.errors import InputError, brief
from earl_jax.metrics.continuing import init_counters
from earl_jax.protocol import Rules
from earl_jax.runs.hosts import gathered
from earl_jax.training.demos import demo_rows
from earl_jax.training.ordering import unfolded
from earl_jax.training.state import MAP_BINS, LaneState, Problem, TrainState

LONGEST_SHARED = 131_072
"""Steps up to which a replay has rows for longer runs, too; 30 MB for one controller on the task with the largest rows."""


def init_train_state(
    problem: Problem, method: Method, keys: jax.Array, steps: int, rules: Rules | None = None
) -> TrainState:
    """Return N lanes at step 0 of `steps` from PRNG keys [N]; leaves of `method` and `rules` have a leading lane axis.

    Without `rules`, every lane uses the rules of the problem's protocol.
    """
    if rules is None:
        rules = jax.tree.map(lambda rule: jnp.full(keys.shape[0], rule), problem.protocol.rules)
    lanes = jax.vmap(lambda *lane: init_lane(problem, *lane))(method, keys, rules)
    replay = init_replay(problem, method, keys.shape[0], steps)
    start = lanes.env_state.obs[None, :, : problem.env.state_size]
    state = jax.lax.dynamic_update_slice(replay.state, start, (replay.row, 0, 0))
    return TrainState(lanes, replay.replace(state=state), jnp.zeros((), jnp.int32))


def init_lane(problem: Problem, method: Method, key: jax.Array, rules: Rules) -> LaneState:
    """Return one lane at step 0."""
    env, goals = problem.env, problem.goals
    agent_key, method_key, env_key, goal_key, lane_key = jax.random.split(key, 5)
    method_state = method.init(method_key, env, goals)
    task = goals.draw_task(jax.random.fold_in(goal_key, 1))
    phase, phase_step = jnp.asarray(TASK, jnp.int32), jnp.zeros((), jnp.int32)
    goal_indices = method.next_goal(goal_key, goals, phase, GoalIndices(task, task), method_state)
    require_tuple(f"{method.name}: next_goal", goal_indices, GoalIndices)
    for index in goal_indices:
        require_result(f"{method.name}: what next_goal returns", index, (), "index")
    env_state = env.with_goal(env.reset(env_key), jnp.asarray(goals.table)[goal_indices.goal])
    return LaneState(
        key=lane_key,
        env_state=env_state,
        phase=phase,
        phase_step=phase_step,
        goal_indices=goal_indices,
        agent=_init_agents(problem, method, agent_key),
        method_state=method_state,
        counters=init_counters(env, env_state, method.learner.diagnostics),
        rules=rules,
        visits=None if env.map is None else jnp.zeros((MAP_BINS, MAP_BINS), jnp.int32),
    )


def _init_agents(problem: Problem, method: Method, key: jax.Array) -> Any:
    """Return the agents of all controllers before the first step, leaves [C, ...]."""
    env = problem.env

    def init_agent(controller_key):
        return method.learner.init(controller_key, env.observation_size, env.action_size, method.entropy_free_pairs)

    agents = jax.vmap(init_agent)(jax.random.split(key, controller_count(method)))
    demos = demo_rows(problem, method).steps(problem.goals.table)
    pretrained = method.pretrain(jax.random.fold_in(key, 1), env, agents, demos)
    require_like(f"{method.name}: pretrain must return the agent", pretrained, agents)
    return pretrained


def check_lanes(problem: Problem, method: Method, state: TrainState) -> None:
    """Raise an InputError if a lane of `state` has invalid goals from `next_goal`, or values that are not finite."""
    lanes, goals, env = state.lanes, problem.goals, problem.env
    for name, indices in gathered(lanes.goal_indices)._asdict().items():
        count = goals.tasks if name == "task" else len(goals.table)
        if ((indices < 0) | (indices >= count)).any():
            given = f"next_goal returned the indices {brief(indices)} as the {name} of its lanes"
            raise InputError(f"{method.name}: {given}; on this task they are 0 to {count - 1}")
    if gathered(state.step):
        return
    for name in ("obs", "reward"):
        if not np.isfinite(start := gathered(getattr(lanes.env_state, name))).all():
            raise InputError(f"{env.name}: {name} must be finite after reset, not {brief(start)}")


def replay_steps(method: Method, steps: int) -> int:
    """Return the length of the runs that share a program with one of `steps` steps, whose replay has rows for all of them.

    It is the next power of two for a run up to `LONGEST_SHARED`, and the same for all runs that evict transitions.
    """
    most = kept_transitions(method) or math.inf
    if steps > most:
        return int(most) + 1
    return steps if steps > LONGEST_SHARED else int(min(most, 1 << (steps - 1).bit_length()))


def empty_replay(problem: Problem, method: Method, lanes: int, steps: int) -> Replay:
    """Return the replay of `lanes` lanes for the demonstrations and `replay_steps` steps, with all of its rows free.

    If the replay keeps fewer steps than that, it evicts transitions. It then has one more row for the state after the
    newest transition, and the list of each controller has a place for every other row.
    """
    env, demos, most = problem.env, demo_rows(problem, method), kept_transitions(method)
    steps = replay_steps(method, steps)
    rows, listed = len(demos.states), int(demos.copies.sum())
    if most is None or steps <= most:
        capacity, slots = steps + max(rows, listed), None
    else:
        capacity, slots = most + 1 + rows, listed + controller_count(method) * most
    return replay_lib.create(capacity, lanes, env.state_size, env.action_size, env.sparse, slots)


def init_replay(problem: Problem, method: Method, lanes: int, steps: int) -> Replay:
    """Return the initial replay of `lanes` lanes for `steps` steps, demonstrations first."""
    env, demos = problem.env, demo_rows(problem, method)
    replay = empty_replay(problem, method, lanes, steps)
    if not len(demos.rows):
        return replay
    replay = unfolded(replay)
    obs = jnp.concatenate([demos.states[demos.rows + 1], problem.goals.table[demos.goals]], axis=-1)
    success, ends = env.success(obs) & env.sparse, any(phase.ends_on_success for phase in method.phases)
    goal, no = jnp.asarray(demos.goals), jnp.zeros_like(success)
    reached, passed = (success, no) if ends else (no, success)
    flags = TransitionFlags(goal=goal, reached=reached, timeout=no, no_successor=no, absorbed=no, passed=passed)
    first, second = demos.sampleable(0), demos.sampleable(1)
    index = replay.index.at[: len(first)].set(first[:, None])
    index = index.at[len(index) - len(second) :].set(second[::-1, None])
    return replay.replace(
        state=replay.state.at[: len(demos.states)].set(demos.states[:, None]),
        action=replay.action.at[demos.rows].set(demos.actions[:, None]),
        flags=replay.flags.at[demos.rows].set(replay_lib.pack(flags)[:, None]),
        reward=replay.reward if env.sparse else replay.reward.at[demos.rows].set(env.reward(obs)[:, None]),
        index=index,
        counts=jnp.broadcast_to(jnp.array([len(first), len(second)], jnp.int32), (lanes, 2)),
        demos=jnp.array([len(first), len(second)], jnp.int32),
        row=jnp.asarray(len(demos.states), jnp.int32),
        first_row=jnp.asarray(len(demos.states), jnp.int32),
    )
