"""Variants of VaPRL for difference 14: `earl-jax train TASK --algo NAME --import benchmarks/paper/vaprl_variants.py`."""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import optax
from flax import struct

import earl_jax
from earl_jax.algos.goals import GoalIndices, Goals
from earl_jax.algos.learner.replay import TransitionBatch
from earl_jax.algos.method import Phase, PhaseDemos
from earl_jax.algos.vaprl import Curriculum, VaPRL
from earl_jax.envs import Env
from earl_jax.envs.state import tree_where
from earl_jax.options.values import COUNT, within

OPTIMISER = optax.adam(3e-4)
THRESHOLD = 1.0
LARGEST = 1.0


class DualCurriculum(struct.PyTreeNode):
    """Scaled values [G, C], the weight of the values and the state of its optimiser."""

    values: jax.Array
    weight: jax.Array
    optimiser: Any


class VaPRLDual(VaPRL):
    """VaPRL with the released search: the subgoal minimises its distance to the initial states minus weight times value.

    The weight begins at 0, and Adam raises it while the chosen subgoal's value is below 1, every 400 steps. The released
    folder `curriculum_reset/th1.0` names this threshold; the value has the reward's scale and the entropy bonus, as in
    the release. The release updates with the values of the subgoals chosen since the last update, this variant with that
    of the subgoal that it would choose now.
    """

    refresh_every: int = struct.field(pytree_node=False, default=400, metadata=within(COUNT))
    value_samples: int = struct.field(pytree_node=False, default=10, metadata=within("[1, 1024]"))

    name: ClassVar[str] = "vaprl_dual"
    entropy_free_pairs: ClassVar[int] = 0

    def init(self, key: jax.Array, env: Env, goals: Goals) -> DualCurriculum:
        weight = jnp.zeros(())
        return DualCurriculum(jnp.zeros((goals.tasks, len(goals.candidates))), weight, OPTIMISER.init(weight))

    def next_goal(
        self, key: jax.Array, goals: Goals, phase: jax.Array, current: GoalIndices, method_state: DualCurriculum
    ) -> GoalIndices:
        scores = method_state.weight * method_state.values - self.distance(goals)
        return super().next_goal(key, goals, phase, current, Curriculum(scores))

    def choose(self, values: jax.Array, goals: Goals) -> jax.Array:
        return jnp.argmax(values)

    def distance(self, goals: Goals) -> jax.Array:
        start = goals.table[goals.tasks : goals.tasks + goals.initials].mean(axis=0)
        return jnp.linalg.norm(goals.candidates - start, axis=-1)

    def pair_values(self, key: jax.Array, agent: Any, starts: Any, ends: Any) -> jax.Array:
        pairs = jnp.concatenate(jnp.broadcast_arrays(starts, ends), axis=-1)
        agent, obs = jax.tree.map(lambda leaf: leaf[0], agent), pairs.reshape(-1, pairs.shape[-1])

        def value(sample_key):
            action = self.learner.act(sample_key, agent.actor, obs)
            return self.learner.q_values(agent.critics, obs, action).min(axis=0)

        values = jax.lax.map(value, jax.random.split(key, self.value_samples)).mean(axis=0)
        return values.reshape(pairs.shape[:-1])

    def reachability(self, key: jax.Array, agent: Any, goals: Goals) -> jax.Array:
        return self.pair_values(key, agent, goals.candidates, goals.table[: goals.tasks, None])

    def refresh(
        self,
        key: jax.Array,
        env: Env,
        goals: Goals,
        agent: Any,
        batch: TransitionBatch | None,
        method_state: DualCurriculum,
    ) -> DualCurriculum:
        values, weight = self.reachability(key, agent, goals), method_state.weight
        chosen = jnp.argmax(weight * values - self.distance(goals), axis=-1)
        gradient = jnp.take_along_axis(values, chosen[:, None], axis=-1).mean() - THRESHOLD
        change, optimiser = OPTIMISER.update(gradient, method_state.optimiser)
        return DualCurriculum(values, jnp.clip(weight + change, 0.0, LARGEST), optimiser)


class VaPRLDualReachable(VaPRLDual):
    """The released search with `use_minimum`, the flag's default: a subgoal must also be reachable.

    Its value is the smaller one of solving the task from it and of reaching it from the goal of the task phase before.
    """

    name: ClassVar[str] = "vaprl_dual_reachable"

    def reachability(self, key: jax.Array, agent: Any, goals: Goals) -> jax.Array:
        tasks = goals.table[: goals.tasks, None]
        reached = self.pair_values(jax.random.fold_in(key, 1), agent, tasks, goals.candidates)
        return jnp.minimum(super().reachability(key, agent, goals), reached)


class VaPRLDualDemos(VaPRLDual):
    """The released search with the flag's default of relabelling: demonstrations alone."""

    name: ClassVar[str] = "vaprl_dual_demos"

    @property
    def phases(self) -> tuple[Phase, ...]:
        """An own transition is stored once, so a relabelled copy of a demonstration has the same weight."""
        forward, back = (PhaseDemos(direction, copies_per_step=1.0) for direction in ("forward", "backward"))
        return Phase((forward,)), Phase((back,))

    def prepare(
        self,
        key: jax.Array,
        env: Env,
        goals: Goals,
        batch: TransitionBatch,
        phase: jax.Array,
        method_state: DualCurriculum,
    ) -> TransitionBatch:
        relabelled = super().prepare(key, env, goals, batch, phase, method_state)
        demonstrated = batch.row < len(goals.ends)
        return relabelled._replace(
            reward=jnp.where(demonstrated, relabelled.reward, batch.reward),
            flags=tree_where(demonstrated, relabelled.flags, batch.flags),
        )


for variant in (VaPRLDual, VaPRLDualReachable, VaPRLDualDemos):
    earl_jax.register_algo(variant.name, variant)
