"""The static table of an env's goals, and the indices into it that a lane carries."""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax import assets
from earl_jax.algos.learner.replay import GOAL_BITS, TransitionBatch
from earl_jax.envs import Env
from earl_jax.errors import InputError


class Goals(NamedTuple):
    """The static table of goals [M, g] of an env: `tasks` task goals, `initials` initial states, demonstrated states.

    Demonstrated states are in the order of the replay's first rows; `ends [C]` gives for each of them the index of the
    last state of its demonstration. `requested []` is the task goal that the environment sets, or -1.
    """

    table: np.ndarray
    tasks: int
    initials: int
    ends: np.ndarray
    requested: jax.Array | int = -1

    @property
    def candidates(self) -> np.ndarray:
        """Demonstrated states [C, g], the subgoals of a curriculum."""
        return self.table[self.tasks + self.initials :]

    def lacks(self, indices: "GoalIndices") -> jax.Array:
        """Return whether `indices` have a goal outside the table, or a task that is not a task goal, bool []."""
        is_goal = (indices.goal >= 0) & (indices.goal < len(self.table))
        return ~(is_goal & (indices.task >= 0) & (indices.task < self.tasks))

    def draw_task(self, key: jax.Array) -> jax.Array:
        """Return the index of a task goal: the one that the environment sets, or a uniform draw."""
        drawn = jax.random.randint(key, (), 0, self.tasks)
        return jnp.where(self.requested < 0, drawn, self.requested)


class GoalIndices(NamedTuple):
    """Indices into the goal table: the policy's `goal`, and the `task` goal that the environment rewards."""

    goal: jax.Array
    task: jax.Array


def later_demonstrated(goals: Goals, row: jax.Array, draw: jax.Array) -> jax.Array:
    """Return a later row [B] of the same demonstration for each demonstrated `row [B]`, chosen by `draw [B]` in [0, 1).

    Row numbers of the replay also index `goals.candidates`, unless the method samples backward demonstrations alone.
    For rows that are not demonstrated, the result has no meaning.
    """
    last = jnp.asarray(goals.ends)[jnp.minimum(row, len(goals.ends) - 1)]
    return row + 1 + jnp.floor(draw * (last - row)).astype(jnp.int32)


def rescored(env: Env, batch: TransitionBatch, goal: jax.Array, changed: jax.Array) -> TransitionBatch:
    """Return `batch [B]` with rewards and successes recomputed under `goal [B, g]` where `changed [B]` is true.

    The batch keeps its goals; the caller sets new ones. Rewards are `env.reward(obs)`, which differs from those that a
    task stores if it overrides `Env.goal_reward`, as the peg with dense rewards does.
    """
    obs = jnp.concatenate([batch.next_state, goal], axis=-1)
    reached = jnp.where(changed, env.success(obs) & env.sparse, batch.flags.reached)
    reward = jnp.where(changed, env.reward(obs), batch.reward)
    return batch._replace(reward=reward, flags=batch.flags._replace(reached=reached))


def goal_table(env: Env) -> Goals:
    """Return the goals of `env`: task goals, initial states and, if there are demonstrations, demonstrated states."""
    return _goal_table(env, *(np.asarray(table).tobytes() for table in (env.goal_states, env.initial_states)))


@functools.cache
def _goal_table(env: Env, *tables: bytes) -> Goals:
    """Return the goals of `env`; `tables` belong to the cache key: `%autoreload` can change them in an equal env."""
    parts, ends = [env.goal_states, env.initial_states], [np.zeros(0, int)]
    if env.state_size == env.goal_size:
        for direction in env.demonstrations.directions:
            states, last = trajectories(env.demonstrations.load(direction))
            parts.append(states)
            ends.append(sum(map(len, ends)) + last)
    table = np.concatenate(parts).astype(np.float32)
    table.setflags(write=False)
    if len(table) > 1 << GOAL_BITS:
        raise InputError(f"{env.name} has {len(table)} goals; the replay can store at most {1 << GOAL_BITS}")
    return Goals(table, len(env.goal_states), len(env.initial_states), np.concatenate(ends))


def trajectories(demos: assets.Demos) -> tuple[np.ndarray, np.ndarray]:
    """Return all states [T + D, s] of D demonstrations, and each one's index of the last state of its demonstration."""
    spans = assets.spans(demos.ends)
    states = [np.vstack([demos.states[span], demos.next_states[span][-1:]]) for span in spans]
    lengths = np.array([len(part) for part in states])
    return np.concatenate(states), np.repeat(np.cumsum(lengths) - 1, lengths)
