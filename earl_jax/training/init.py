"""The initial state of training: new agents, s0 ~ rho, and demonstrations as the first rows of the replay."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.algos.goals import GoalIndices, trajectories
from earl_jax.algos.learner import replay as replay_lib
from earl_jax.algos.learner import sac
from earl_jax.algos.learner.cloning import Demonstrations
from earl_jax.algos.learner.replay import Replay, TransitionFlags
from earl_jax.algos.method import TASK, Method
from earl_jax.errors import InputError
from earl_jax.metrics.continuing import Counters
from earl_jax.metrics.phase_stats import PhaseStats, init_phase_stats
from earl_jax.protocol import Rules
from earl_jax.training.state import MAP_BINS, LaneState, Problem, TrainState


def init_train_state(
    problem: Problem, method: Method, keys: jax.Array, capacity: int, rules: Rules | None = None
) -> TrainState:
    """Return N lanes at step 0 from PRNG keys [N]; leaves of `method` and `rules` have a leading lane axis.

    Without `rules`, every lane has those of the problem's protocol.
    """
    if rules is None:
        rules = jax.tree.map(lambda rule: jnp.full(keys.shape[0], rule), problem.protocol.rules)
    lanes = jax.vmap(lambda *lane: init_lane(problem, *lane))(method, keys, rules)
    replay = init_replay(problem, method, keys.shape[0], capacity)
    start = lanes.env_state.obs[None, :, : problem.env.state_size]
    state = jax.lax.dynamic_update_slice(replay.state, start, (replay.row, 0, 0))
    return TrainState(lanes, replay.replace(state=state), jnp.zeros((), jnp.int32))


def init_lane(problem: Problem, method: Method, key: jax.Array, rules: Rules) -> LaneState:
    """Return one lane at step 0."""
    env, goals = problem.env, problem.goals
    agent_key, method_key, env_key, goal_key, lane_key = jax.random.split(key, 5)
    method_state = method.init_state(method_key, env, goals)
    task = goals.draw_task(jax.random.fold_in(goal_key, 1))
    phase, phase_step = jnp.asarray(TASK, jnp.int32), jnp.zeros((), jnp.int32)
    goal_indices = method.next_goal(goal_key, goals, phase, GoalIndices(task, task), method_state)

    def init_agent(controller_key):
        return sac.init(controller_key, method.sac, env.obs_size, env.action_size, method.critics)

    agents = jax.vmap(init_agent)(jax.random.split(agent_key, method.controllers))
    pretrain_key = jax.random.fold_in(agent_key, 1)
    env_state = env.with_goal(env.reset(env_key), jnp.asarray(goals.table)[goal_indices.goal])
    return LaneState(
        key=lane_key,
        env_state=env_state,
        phase=phase,
        phase_step=phase_step,
        goal_indices=goal_indices,
        agent=method.pretrain(pretrain_key, env, agents, demonstrations(problem, method)),
        method_state=method_state,
        counters=_zero_counters(init_phase_stats(env, env_state)),
        rules=rules,
        visits=None if env.map_bounds is None else jnp.zeros((MAP_BINS, MAP_BINS), jnp.int32),
    )


def _zero_counters(phases: PhaseStats) -> Counters:
    zero, none = jnp.zeros(()), jnp.zeros((), jnp.int32)
    return Counters(
        window_reward=zero,
        total_reward=zero,
        interventions=none,
        faults=none,
        reached=none,
        diagnostics=dict.fromkeys(sac.DIAGNOSTICS, zero),
        phases=phases,
    )


class DemoRows(NamedTuple):
    """Demonstrations in the layout of replay rows.

    `states [R, s]`. The other fields belong to T listed transitions: their `rows [T]`, `actions [T, a]`, `goals [T]`,
    `controllers [T]` and `copies [T]` in the replay's lists. A row that two controllers list is there twice.
    """

    states: np.ndarray
    rows: np.ndarray
    actions: np.ndarray
    goals: np.ndarray
    controllers: np.ndarray
    copies: np.ndarray

    def sampleable(self, controller: int) -> np.ndarray:
        """Return the rows that `controller` samples from, each repeated by its number of copies."""
        own = self.controllers == controller
        return np.repeat(self.rows[own], self.copies[own])


def demo_rows(problem: Problem, method: Method) -> DemoRows | None:
    """Return the demonstrations in the initial replay of `method`, or None if the task has none.

    Raises:
        ValueError: the method needs demonstrations, and the task has none or its states cannot be goals.
    """
    if not problem.env.has_demos:
        if method.needs_demos:
            raise InputError(f"{method.name} needs demonstrations, and {problem.env.name} has none")
        return None
    if method.needs_demos and problem.env.state_size != problem.env.goal_size:
        raise InputError(
            f"{method.name} needs demonstrated states that can be goals, but a state of {problem.env.name} has "
            f"{problem.env.state_size} numbers and a goal has {problem.env.goal_size}"
        )
    parts, all_states, first = [], [], 0
    lists = method.demo_lists(problem.env)
    for direction in method.directions(problem.env):
        demos = problem.env.demos(direction)
        states, last = trajectories(demos)
        rows = np.flatnonzero(np.arange(len(states)) < last)
        goals, copies = _goal_indices(problem, demos.goals), method.demo_copies(last[rows] - rows)
        for own in (entry for entry in lists if entry.direction == direction):
            controllers = np.full(len(rows), own.controller)
            parts.append((first + rows, demos.actions, goals, controllers, own.copies * copies))
        all_states.append(states)
        first += len(states)
    fields = [np.concatenate(field) for field in zip(*parts, strict=True)]
    return DemoRows(np.concatenate(all_states), *fields)


def demonstrations(problem: Problem, method: Method) -> Demonstrations | None:
    """Return the demonstrations of `method` to clone, or None if the task has none. Errors as `demo_rows`."""
    demos = demo_rows(problem, method)
    if demos is None:
        return None
    obs = np.concatenate([demos.states[demos.rows], problem.goals.table[demos.goals]], axis=-1)
    return Demonstrations(obs, demos.actions, demos.controllers)


def _goal_indices(problem: Problem, goals: np.ndarray) -> np.ndarray:
    """Return the goal table's indices [T] of demonstrated goals [T, g], which are task goals or initial states."""
    known = problem.goals.table[: problem.goals.tasks + problem.goals.initials]
    distance = np.abs(goals[:, None] - known[None]).max(axis=-1)
    if distance.min(axis=1).max() > 1e-6:
        raise InputError(
            f"a demonstration of {problem.env.name} has a goal that is neither a task goal nor an initial state"
        )
    return distance.argmin(axis=1)


def replay_capacity(problem: Problem, method: Method, steps: int) -> int:
    """Return the number of replay rows for the demonstrations and `steps` steps, or as many as the replay keeps of them.

    If it evicts transitions, one row more holds the state after the newest one.
    """
    demos, most = demo_rows(problem, method), method.sac.replay_capacity
    if most is not None:
        return min(steps, most) + 1 + (0 if demos is None else len(demos.states))
    return steps + (0 if demos is None else max(len(demos.states), int(demos.copies.sum())))


def sample_capacity(method: Method, demos: DemoRows | None, capacity: int) -> int:
    """Return the length of the lists of a replay with `capacity` rows, in which each controller can own all of them."""
    if method.sac.replay_capacity is None:
        return capacity
    states, copies = (0, 0) if demos is None else (len(demos.states), int(demos.copies.sum()))
    return copies + method.controllers * (capacity - states - 1)


def init_replay(problem: Problem, method: Method, lanes: int, capacity: int) -> Replay:
    """Return the initial replay of `lanes` lanes with `capacity` rows, demonstrations first."""
    env, demos = problem.env, demo_rows(problem, method)
    slots = None if method.sac.replay_capacity is None else sample_capacity(method, demos, capacity)
    replay = replay_lib.create(capacity, lanes, env.state_size, env.action_size, env.sparse, slots)
    if demos is None:
        return replay
    obs = jnp.concatenate([demos.states[demos.rows + 1], problem.goals.table[demos.goals]], axis=-1)
    reached = env.success(obs) & env.sparse
    unset = jnp.zeros_like(reached)
    words = replay_lib.pack(
        TransitionFlags(
            goal=jnp.asarray(demos.goals), reached=reached, timeout=unset, no_successor=unset, absorbed=unset
        )
    )
    first, second = demos.sampleable(0), demos.sampleable(1)
    index = replay.index.at[: len(first)].set(first[:, None])
    index = index.at[len(index) - len(second) :].set(second[::-1, None])
    return replay.replace(
        state=replay.state.at[: len(demos.states)].set(demos.states[:, None]),
        action=replay.action.at[demos.rows].set(demos.actions[:, None]),
        flags=replay.flags.at[demos.rows].set(words[:, None]),
        reward=replay.reward if env.sparse else replay.reward.at[demos.rows].set(env.reward(obs)[:, None]),
        index=index,
        counts=jnp.broadcast_to(jnp.array([len(first), len(second)], jnp.int32), (lanes, 2)),
        demos=jnp.array([len(first), len(second)], jnp.int32),
        row=jnp.asarray(len(demos.states), jnp.int32),
        first_row=jnp.asarray(len(demos.states), jnp.int32),
    )
