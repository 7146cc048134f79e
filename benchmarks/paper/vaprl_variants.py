"""Variants of VaPRL for difference 14: `earl-jax train TASK --algo NAME --import benchmarks/paper/vaprl_variants.py`."""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp

import earl_jax
from earl_jax.algos.goals import GoalIndices, Goals
from earl_jax.algos.learner.replay import TransitionBatch
from earl_jax.algos.vaprl import Curriculum, VaPRL
from earl_jax.envs import Env
from earl_jax.envs.state import tree_where


class VaPRLReachable(VaPRL):
    """VaPRL whose subgoals must also be reachable from where the task phase before them ends.

    The value of a candidate is the smaller one of solving the task from it and of reaching it, as with `use_minimum`, the
    default of the released flag; its only released configuration sets it to 0. The release takes the state in which the
    task phase ended, this variant the goal of that phase.
    """

    name: ClassVar[str] = "vaprl_reachable"

    def init(self, key: jax.Array, env: Env, goals: Goals) -> Curriculum:
        return Curriculum(jnp.zeros((2, goals.tasks, len(goals.candidates))))

    def next_goal(
        self, key: jax.Array, goals: Goals, phase: jax.Array, current: GoalIndices, method_state: Curriculum
    ) -> GoalIndices:
        solved, reached = method_state.values
        least = Curriculum(jnp.minimum(solved, reached[current.task]))
        return super().next_goal(key, goals, phase, current, least)

    def refresh(
        self,
        key: jax.Array,
        env: Env,
        goals: Goals,
        agent: Any,
        batch: TransitionBatch | None,
        method_state: Curriculum,
    ) -> Curriculum:
        solved = super().refresh(key, env, goals, agent, batch, method_state).values
        tasks = goals.table[: goals.tasks, None]
        reached = self.pair_values(jax.random.fold_in(key, 1), agent, tasks, goals.candidates)
        return Curriculum(jnp.stack([solved, reached]))


class VaPRLDemoRelabelling(VaPRL):
    """VaPRL that relabels demonstrations alone: the default of the released flag, whose goals are those of one task.

    The release then stores a transition of its own once, so a relabelled copy of a demonstration has the same weight.
    """

    name: ClassVar[str] = "vaprl_demo_relabelling"
    demo_copies: ClassVar[float] = 1.0

    def prepare(
        self, key: jax.Array, env: Env, goals: Goals, batch: TransitionBatch, phase: jax.Array, method_state: Curriculum
    ) -> TransitionBatch:
        relabelled = super().prepare(key, env, goals, batch, phase, method_state)
        demonstrated = batch.row < len(goals.ends)
        return relabelled._replace(
            reward=jnp.where(demonstrated, relabelled.reward, batch.reward),
            flags=tree_where(demonstrated, relabelled.flags, batch.flags),
        )


for variant in (VaPRLReachable, VaPRLDemoRelabelling):
    earl_jax.register_algo(variant.name, variant)
