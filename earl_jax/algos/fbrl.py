"""Forward-backward RL: one controller does the task, a second one returns the environment to an initial state."""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from flax import struct

from earl_jax.algos.goals import GoalIndices, Goals
from earl_jax.algos.method import BACKWARD, RETURN, Method, Phase
from earl_jax.options.values import within


class FBRL(Method):
    """Alternate a controller to the goals and one back.

    Alternate a forward controller on task goals and a backward one on initial states, each with its own replay.

    Source: Han et al. 2015 and Eysenbach et al. 2018, as run by Sharma et al. 2022. Both phases end on success or after
    H_E steps, and only the acting controller learns. The released variants differ; this one reproduces the published
    cycle of 92 steps.
    """

    controllers: int = struct.field(pytree_node=False, default=2, metadata=within("[1, 2]"))
    """2, or 1 for one goal-conditioned agent that does both ("the same policy with different task variables", A.3)."""
    fixed_phases: bool = struct.field(pytree_node=False, default=False)
    """Whether every phase lasts H_E steps, without an end on success ("for a fixed number of environment steps", A.3)."""

    name: ClassVar[str] = "fbrl"

    @property
    def phases(self) -> tuple[Phase, ...]:
        on_success = not self.fixed_phases
        back = Phase((BACKWARD,), controller=self.controllers - 1, ends_on_success=on_success)
        return Phase(ends_on_success=on_success), back

    def next_goal(
        self, key: jax.Array, goals: Goals, phase: jax.Array, current: GoalIndices, method_state: Any
    ) -> GoalIndices:
        task_key, initial_key = jax.random.split(key)
        task = goals.draw_task(task_key)
        initial = goals.tasks + jax.random.randint(initial_key, (), 0, goals.initials)
        back = phase == RETURN
        return GoalIndices(goal=jnp.where(back, initial, task), task=jnp.where(back, current.task, task))
