"""The rules of the ARL formalism: when an environment is reset, when its goal changes, how a step ends and is counted.

Source: Sharma et al. 2022, section 4. docs/formalism.md has the equations.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.envs import Env, State
from earl_jax.envs.checks import require_like, require_result
from earl_jax.envs.starts import EVAL_PAIRS
from earl_jax.envs.state import tree_where
from earl_jax.errors import require_known
from earl_jax.metrics.continuing import Counters
from earl_jax.metrics.deployed import deployed
from earl_jax.metrics.phase_stats import advance_phase_stats
from earl_jax.options.schedule import Schedule
from earl_jax.options.values import COUNT, COUNT_OR_NEVER, EPISODES, check_intervals, within

EVALUATION_KEY = 2
"""Number folded into a lane's key for an evaluation, so that evaluations do not change the randomness of the life."""


class Rules(NamedTuple):
    """The rules of resets and goal changes as arrays, which can differ between the lanes of one program.

    `horizon []`, int32: steps between hard interventions, 0 for never. `chance []`, float32: probability of a hard
    intervention after any step. `goal_change []`, int32: steps between goal changes by the environment, 0 if every
    attempt draws its own goal.
    """

    horizon: Any
    chance: Any
    goal_change: Any

    def intervened(self, step: jax.Array, key: jax.Array) -> jax.Array:
        """Return whether a hard intervention follows step number `step`, counted from 1, bool []."""
        return _every(step, self.horizon) | (jax.random.uniform(key) < self.chance)


class Attempt(NamedTuple):
    """The agent's attempt at a goal at the start of a step, an argument of `advance_rules`.

    bool `is_task []`: the goal is a task goal, not the goal of a return phase; bool `expires []`: the attempt times out
    after this step unless the goal is reached; bool `ends_on_success []`; bool `reset_at_end []`: the end of the
    attempt also resets the environment; bool `invalid_reward []`: the step earned a task reward that is not finite,
    which is a fault. For metrics: bool `has_goal []`, whether the attempt counts, and int32 `age []`, its earlier
    steps.
    """

    is_task: Any
    expires: Any
    ends_on_success: Any
    reset_at_end: Any
    invalid_reward: Any = False
    has_goal: Any = True
    age: Any = 0


class StepEnd(NamedTuple):
    """The end of one step, bool scalars.

    `phase_ended`: the attempt's goal was `reached`, or it hit a `timeout`. `passed`: the state is at the goal of an
    attempt that success does not end. `fault`: the simulation broke, and the step is discarded. `goal_changes`: the
    environment sets another goal. `task_restarts`: the next attempt pursues the task goal, because an intervention or a
    goal change ended this one. `env_reset`: the environment is reset to s0 ~ rho, but never after the life's end.
    """

    fault: jax.Array
    reached: jax.Array
    passed: jax.Array
    timeout: jax.Array
    phase_ended: jax.Array
    goal_changes: jax.Array
    task_restarts: jax.Array
    env_reset: jax.Array


def advance_rules(
    rules: Rules, env: Env, env_state: State, attempt: Attempt, step: jax.Array, key: jax.Array
) -> StepEnd:
    """Return the end of step number `step`, counted from 1, which led to `env_state`; training and adapters use this.

    `key` draws interventions by chance. A fault resets the environment, as an intervention does.
    """
    fault = env.fault(env_state)
    require_result(f"{env.name}: what fault returns", fault, (), "bool")
    fault = fault | attempt.invalid_reward
    success = env.sparse & env.success(env_state.obs) & ~fault & (env_state.done == 0)
    reached = success & attempt.ends_on_success
    intervened = rules.intervened(step, key) | fault
    goal_changes = _every(step, rules.goal_change)
    over = reached | attempt.expires
    task_restarts = intervened | (goal_changes & attempt.is_task & ~over)
    phase_ended = over | task_restarts
    return StepEnd(
        fault=fault,
        reached=reached,
        passed=success & ~reached,
        timeout=phase_ended & ~reached,
        phase_ended=phase_ended,
        goal_changes=goal_changes,
        task_restarts=task_restarts,
        env_reset=(intervened | (phase_ended & attempt.reset_at_end)) & (env_state.done == 0),
    )


def reset_where(reset: jax.Array, env: Env, key: jax.Array, env_state: State) -> State:
    """Return the state after a hard intervention if `reset`, bool [], is true, else `env_state`.

    This is a select instead of a branch, because a branch under vmap would compute both sides anyway.
    """
    fresh = env.intervene(key, env_state)
    require_like(f"{env.name}: intervene must return the state", fresh, env_state)
    return tree_where(reset, fresh, env_state)


def count_step(
    counters: Counters, env: Env, env_state: State, attempt: Attempt, end: StepEnd, earned: jax.Array, step: jax.Array
) -> Counters:
    """Return the counters after step number `step`, counted from 1, which led to `env_state` and ended as `end`.

    `earned []`, the reward for the task goal, does not count after a fault. No phase ends once the life is over.
    """
    ended = end.phase_ended & attempt.has_goal & (env_state.done == 0)
    at_goal = (end.reached | end.passed) & attempt.has_goal
    phases = advance_phase_stats(counters.phases, env, env_state, attempt.is_task, ended, at_goal, step, attempt.age)
    return counters.replace(
        window_reward=counters.window_reward + jnp.where(end.fault, 0.0, earned),
        interventions=counters.interventions + end.env_reset,
        faults=counters.faults + end.fault,
        reached=phases.reached[0],
        phases=phases,
    )


def _every(step: jax.Array, period: jax.Array) -> jax.Array:
    return (period > 0) & (step % jnp.maximum(period, 1) == 0)


@dataclasses.dataclass(frozen=True)
class Protocol:
    """The protocol of a lifetime: interventions, goal changes, and evaluations of the greedy policy from s0 ~ rho."""

    train_horizon: int = dataclasses.field(metadata=within(COUNT_OR_NEVER))
    """H_T: steps between hard interventions, which reset the environment to s0 ~ rho; 0 for never."""
    eval_horizon: int = dataclasses.field(metadata=within(COUNT))
    """H_E: steps of an evaluation episode."""
    eval_every: int = dataclasses.field(default=Schedule.eval_every, metadata=within(COUNT))
    """Training steps between deployed evaluations."""
    eval_episodes: int = dataclasses.field(default=Schedule.eval_episodes, metadata=within(EPISODES))
    """Episodes of one deployed evaluation."""
    intervention_chance: float = dataclasses.field(default=0.0, metadata=within("[0, 1]"))
    """epsilon: probability of a hard intervention after a step, p~ = (1 - epsilon) p + epsilon rho."""
    goal_change: int = dataclasses.field(default=0, metadata=within(COUNT_OR_NEVER))
    """Steps between goal changes in the continuing setting; 0 if every attempt draws its goal from p_g."""
    alive_steps: int = dataclasses.field(default=2_000, metadata=within(COUNT))
    """Steps within which a lane must reach the goals of its phases to count as alive (`continuing/alive`)."""
    eval_pairs: str = EVAL_PAIRS[0]
    """How evaluations draw pairs of start and task goal: each pair at `random`, or all equally often (`balanced`)."""

    def __post_init__(self):
        require_known("eval_pairs", self.eval_pairs, EVAL_PAIRS)
        check_intervals("protocol", self)

    @property
    def rules(self) -> Rules:
        """The part of this protocol that a lane carries as scalar arrays."""
        return Rules(
            horizon=np.int32(self.train_horizon),
            chance=np.float32(self.intervention_chance),
            goal_change=np.int32(self.goal_change),
        )

    @property
    def without_rules(self) -> "Protocol":
        """The part that all lanes of a program share: this protocol without interventions and goal changes."""
        return dataclasses.replace(self, train_horizon=0, intervention_chance=0.0, goal_change=0)

    def deployed(self, task: Env, policy: Callable[[jax.Array], jax.Array], key: jax.Array) -> dict[str, jax.Array]:
        """Return the metrics of a deployed evaluation of `policy(obs) -> action` in `task`, from a lane's `key []`."""
        key, wide = jax.random.fold_in(key, EVALUATION_KEY), task.starts.wide
        return deployed(task, policy, key, self.eval_horizon, self.eval_episodes, wide=wide, pairs=self.eval_pairs)
