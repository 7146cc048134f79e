"""Forward-backward RL with one controller that does not always return home."""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp

from earl_jax.algos.goals import GoalIndices, Goals
from earl_jax.algos.method import BACKWARD, RETURN, Method, Phase


class Detour(Method):
    """Between two attempts, return to an initial state or go to another task goal."""

    home_share: float = 0.5
    """Share of the return phases that lead to an initial state."""

    name: ClassVar[str] = "detour"
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
        task_key, home_key, share_key = jax.random.split(key, 3)
        task = goals.draw_task(task_key)
        home = goals.tasks + jax.random.randint(home_key, (), 0, goals.initials)
        target = jnp.where(jax.random.bernoulli(share_key, self.home_share), home, task)
        back = phase == RETURN
        return GoalIndices(goal=jnp.where(back, target, task), task=jnp.where(back, current.task, task))
