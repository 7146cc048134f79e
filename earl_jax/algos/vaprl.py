"""VaPRL: one goal-conditioned agent that practises from states where its value predicts success."""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from flax import struct

from earl_jax.algos.goals import GoalIndices, Goals, later_demonstrated, rescored
from earl_jax.algos.learner.replay import TransitionBatch
from earl_jax.algos.method import RETURN, Method, Phase, PhaseDemos
from earl_jax.envs import Env
from earl_jax.options.values import COUNT, within


class Curriculum(struct.PyTreeNode):
    """The agent's values [G, C] of starts at each of C demonstrated states, for each of G task goals."""

    values: jax.Array


class VaPRL(Method):
    """Alternate the task and subgoals from demonstrations.

    Alternate task episodes with episodes to a subgoal: the demonstrated state nearest rho whose value is >= epsilon.

    Source: Sharma et al. 2021 (VaPRL), equation 4, with relabelling as in the released `reset_free_learning`. There are
    four deliberate differences. Values come from a pair of critics without entropy bonus, in units of one reward, so
    epsilon is a discounted success probability (the release has a flag for it). The constraint is the paper's; the
    release minimises the distance minus the value times a learnt multiplier. The table of values is refreshed every 200
    steps instead of in every phase. Goals are relabelled when transitions are sampled, in all episodes and with any
    goal of the table; the release optionally stores copies of failed episodes with goals from a list of ten.
    """

    epsilon: float = struct.field(default=0.1, metadata=within("[-1000000, 1000000]"))
    """Smallest value of a subgoal, a discounted success probability; not in the papers, 0.01 to 0.3 is reasonable."""
    relabel_share: float = struct.field(default=0.8, metadata=within("[0, 1]"))
    """Share of sampled transitions that are relabelled: N of N + 1 with N = 4 (VaPRL paper)."""
    value_samples: int = struct.field(pytree_node=False, default=4, metadata=within("[1, 1024]"))
    """Number of actions over which a value is averaged (released code: 10)."""

    refresh_every: int = struct.field(pytree_node=False, default=200, metadata=within(COUNT))
    """Steps between refreshes of the value table."""
    nearest_fallback: bool = struct.field(pytree_node=False, default=True)
    """Whether the subgoal is the demonstrated state nearest the initial states if no value reaches `epsilon`. The
    release, whose weight on values starts at 0, also begins there. False: the state of highest value."""
    unmet_goals: bool = struct.field(pytree_node=False, default=True)
    """Whether a transition is relabelled only with a goal that the state before its step does not meet. In the release,
    a relabelled copy of an episode ends at the first state that meets its goal."""

    name: ClassVar[str] = "vaprl"
    needs_demos: ClassVar[bool] = True
    entropy_free_pairs: ClassVar[int] = 1

    @property
    def phases(self) -> tuple[Phase, ...]:
        """The phases. A relabelled copy of a demonstration counts a fifth of an own transition, stored 1 + 4 times."""
        forward, back = (PhaseDemos(direction, copies_per_step=0.2) for direction in ("forward", "backward"))
        return Phase((forward,)), Phase((back,))

    def init(self, key: jax.Array, env: Env, goals: Goals) -> Curriculum:
        return Curriculum(jnp.zeros((goals.tasks, len(goals.candidates))))

    def next_goal(
        self, key: jax.Array, goals: Goals, phase: jax.Array, current: GoalIndices, method_state: Curriculum
    ) -> GoalIndices:
        """Return the goals of a new phase.

        A return phase draws the next task goal and pursues its subgoal. The next task phase pursues that task goal.
        """
        queued = jnp.where(phase == RETURN, goals.draw_task(key), current.task)
        subgoal = goals.tasks + goals.initials + self.choose(method_state.values[queued], goals)
        return GoalIndices(goal=jnp.where(phase == RETURN, subgoal, queued), task=queued)

    def choose(self, values: jax.Array, goals: Goals) -> jax.Array:
        """Return the index of the candidate nearest the mean initial state among those with `values [C]` >= epsilon.

        If there are none, it is the nearest candidate or, without `nearest_fallback`, the one with the highest value.
        """
        start = goals.table[goals.tasks : goals.tasks + goals.initials].mean(axis=0)
        distance = jnp.linalg.norm(goals.candidates - start, axis=-1)
        solvable = values >= self.epsilon
        fallback = jnp.argmin(distance) if self.nearest_fallback else jnp.argmax(values)
        return jnp.where(solvable.any(), jnp.argmin(jnp.where(solvable, distance, jnp.inf)), fallback)

    def refresh(
        self,
        key: jax.Array,
        env: Env,
        goals: Goals,
        agent: Any,
        batch: TransitionBatch | None,
        method_state: Curriculum,
    ) -> Curriculum:
        """Return the value of each candidate for each task goal in units of one reward: means of `value_samples`."""
        tasks = goals.table[: goals.tasks, None]
        pairs = jnp.concatenate(jnp.broadcast_arrays(goals.candidates, tasks), axis=-1)
        agent, obs = jax.tree.map(lambda leaf: leaf[0], agent), pairs.reshape(-1, pairs.shape[-1])

        def value(sample_key):
            return self.learner.value(sample_key, agent, obs)

        values = jax.lax.map(value, jax.random.split(key, self.value_samples)).mean(axis=0)
        return Curriculum(values.reshape(pairs.shape[:-1]) / self.learner.reward_scale)

    def prepare(
        self, key: jax.Array, env: Env, goals: Goals, batch: TransitionBatch, phase: jax.Array, method_state: Curriculum
    ) -> TransitionBatch:
        """Return `batch` with another goal for `relabel_share` of its transitions.

        A demonstrated transition gets a later state of its demonstration, any other transition a goal of the table. A
        transition keeps its goal if it has no successor or, with `unmet_goals`, if its state meets the new goal.
        """
        share_key, goal_key = jax.random.split(key)
        draw = jax.random.uniform(goal_key, batch.reward.shape)
        later = later_demonstrated(goals, batch.row, draw)
        any_goal = jnp.floor(draw * len(goals.table)).astype(jnp.int32)
        goal = jnp.where(batch.row < len(goals.ends), goals.tasks + goals.initials + later, any_goal)
        chosen = jax.random.bernoulli(share_key, self.relabel_share, goal.shape) & ~batch.flags.no_successor
        goal_states = jnp.asarray(goals.table)[goal]
        if self.unmet_goals:
            chosen &= ~env.success(jnp.concatenate([batch.state, goal_states], axis=-1))
        flags = batch.flags._replace(goal=jnp.where(chosen, goal, batch.flags.goal))
        return rescored(env, batch._replace(flags=flags), goal_states, chosen)
