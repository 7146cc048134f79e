"""The state of training: lanes with their replay, the random keys of a step, and the problem to learn."""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from flax import struct

from earl_jax.algos.goals import GoalIndices, Goals, goal_table
from earl_jax.algos.learner.replay import Replay
from earl_jax.envs import Env, State
from earl_jax.envs.checks import check_task
from earl_jax.envs.state import struct_text
from earl_jax.metrics.continuing import Counters
from earl_jax.options.values import require_object
from earl_jax.protocol import Protocol, Rules

MAP_BINS = 64
"""Number of bins along a side of the map of visited positions."""


Warmup = bool | jax.Array
"""Whether steps act uniformly at random and do not learn: `True` skips updates, a traced flag, bool [], drops them."""


class LaneState(struct.PyTreeNode):
    """The state of one lane, which trains one seed.

    `visits [MAP_BINS, MAP_BINS]`, int32, counts visited positions, first axis x; None if the task has no map.
    """

    key: jax.Array
    env_state: State
    phase: jax.Array
    phase_step: jax.Array
    goal_indices: GoalIndices
    agent: Any
    method_state: Any
    counters: Counters
    rules: Rules
    visits: jax.Array | None

    __repr__ = struct_text


def count_visit(env: Env, lane: LaneState, obs: jax.Array) -> jax.Array | None:
    """Return the visits of `lane` plus the position in `obs [o]`, if that is finite and the lifetime has not ended."""
    if env.map is None or lane.visits is None:
        return None
    low, high = env.map.bounds
    bins = jnp.floor((env.map.position(obs) - low) / (high - low) * MAP_BINS)
    counted = jnp.isfinite(bins) & ~(lane.env_state.done > 0)
    x, y = jnp.where(counted, jnp.clip(bins, 0, MAP_BINS - 1), MAP_BINS).astype(jnp.int32)
    return lane.visits.at[x, y].add(1, mode="drop")


class TrainState(struct.PyTreeNode):
    """All lanes (leading axis N), their replay, and the number of steps that each has taken."""

    lanes: LaneState
    replay: Replay
    step: jax.Array

    __repr__ = struct_text


class StepKeys(NamedTuple):
    """The random keys of one lane at one step, which depend on its seed and the step alone."""

    act: jax.Array
    goal: jax.Array
    reset: jax.Array
    sample: jax.Array
    prepare: jax.Array
    learn: jax.Array

    @property
    def chance(self) -> jax.Array:
        """The key of interventions by chance; with a small number it could equal a key that a reset splits off."""
        return jax.random.fold_in(self.reset, 1 << 31)


def step_keys(key: jax.Array, step: jax.Array) -> StepKeys:
    """Return the random keys at `step` of the lane with the key `key`."""
    return StepKeys(*jax.random.split(jax.random.fold_in(key, step), len(StepKeys._fields)))


def seed_keys(seeds: Sequence[int]) -> jax.Array:
    """Return the PRNG keys [N] of the lanes of `seeds`."""
    return jax.vmap(jax.random.key)(jnp.asarray(seeds, jnp.uint32))


@jax.tree_util.register_static
@dataclasses.dataclass(frozen=True)
class Problem:
    """The static arguments of a program: the environment, the protocol of its training, and the steps of a `lifetime`.

    It is a pytree without leaves, so a jitted function accepts it as an argument without `static_argnames`.
    """

    env: Env
    protocol: Protocol
    steps: int | None = None

    def __post_init__(self):
        require_object("task", self.env, Env, or_name=False)
        require_object("protocol", self.protocol, Protocol, or_name=False)
        check_task(self.env)

    def __repr__(self) -> str:
        sizes = f"obs [{self.env.observation_size}], action [{self.env.action_size}], steps {self.steps}"
        return f"Problem({sizes},\n  {self.env},\n  {self.protocol})"

    @property
    def goals(self) -> Goals:
        """The goal table, to which the goal indices in the replay refer."""
        return goal_table(self.env)
