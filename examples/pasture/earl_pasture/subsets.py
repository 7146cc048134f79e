"""A sum of rewards over subsets of states: MTRF with the tasks "reach the goal" and "return"."""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp

from earl_jax.algos.goals import GoalIndices, Goals, rescored
from earl_jax.algos.learner.replay import TransitionBatch
from earl_jax.algos.method import BACKWARD, RETURN, Method, Phase
from earl_jax.envs import Env


class Subsets(Method):
    """One goal-conditioned agent that learns every transition under the task whose subset it began in.

    Acting follows phases instead of subsets: a phase that reached its goal ends in the other subset.
    """

    name: ClassVar[str] = "subsets"
    phases: ClassVar[tuple[Phase, ...]] = (Phase(), Phase((BACKWARD,)))

    def next_goal(
        self,
        key: jax.Array,
        goals: Goals,
        phase: jax.Array,
        current: GoalIndices,
        method_state: Any,
    ) -> GoalIndices:
        """Return the goals of a new phase as indices: task goals first, then initial states."""
        task, home = draw_goals(key, goals, ())
        back = phase == RETURN
        return GoalIndices(goal=jnp.where(back, home, task), task=jnp.where(back, current.task, task))

    def prepare(
        self, key: jax.Array, env: Env, goals: Goals, batch: TransitionBatch, phase: jax.Array, method_state: Any
    ) -> TransitionBatch:
        """Return `batch [B]` under the goal of the subset S_k of its states."""
        table = jnp.asarray(goals.table)
        ends = table[: goals.tasks + goals.initials]
        nearest = jnp.linalg.norm(batch.state[:, None] - ends, axis=-1).argmin(axis=-1)
        task, home = draw_goals(key, goals, batch.reward.shape)
        own_task = jnp.where(batch.flags.goal < goals.tasks, batch.flags.goal, task)
        goal = jnp.where(nearest >= goals.tasks, own_task, home)
        goal = jnp.where(batch.flags.no_successor, batch.flags.goal, goal)
        changed = goal != batch.flags.goal
        return rescored(env, batch._replace(flags=batch.flags._replace(goal=goal)), table[goal], changed)


def draw_goals(key: jax.Array, goals: Goals, shape: tuple[int, ...]) -> tuple[jax.Array, jax.Array]:
    """Return indices `shape` of task goals and of initial states, drawn uniformly."""
    task_key, home_key = jax.random.split(key)
    home = goals.tasks + jax.random.randint(home_key, shape, 0, goals.initials)
    draw = goals.draw_task(task_key) if shape == () else jax.random.randint(task_key, shape, 0, goals.tasks)
    return draw, home
