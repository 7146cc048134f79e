"""A life under the protocol for a training loop of your own: pure functions of one lane, for `scan`, `jit` and `vmap`.

`init` starts a life, `advance` makes one step, and `evaluate` measures both of the paper's scores. The rules are the
same as in the training loop (`advance_rules`, `count_step`, `reset_where`), but the random draws differ: the key of the
state draws interventions, goals and resets, so a run of `earl_jax.train` with the same seed is a different life.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import struct

from earl_jax.envs import Env, State
from earl_jax.envs.checks import check_task
from earl_jax.metrics.continuing import Counters, continuing, init_counters
from earl_jax.metrics.phase_stats import advance_phase_stats
from earl_jax.options.jax_settings import package_types
from earl_jax.options.values import COUNT, require, require_object
from earl_jax.protocol.rules import Attempt, Protocol, Rules, StepEnd, advance_rules, count_step, reset_where

ATTEMPT_STEPS = 1000
"""Steps after which naive RL gives up a goal that it has not reached (Sharma et al. 2022, section 6.1)."""
DIRECTIONS = 2
"""Attempts at task goals and at goals that the agent sets are counted separately."""


class ProtocolState(struct.PyTreeNode):
    """The life of one lane, between two steps.

    `key`: draws all future randomness; `env_state`; `rules` and int32 `attempt_steps []`: data that can differ between
    lanes; int32 `step []`: steps so far; int32 `attempt_age []`: steps since the attempt at the current goal began;
    `task_goal [g]`: the goal whose reward C(A) counts; bool `goal_is_set []`: the agent pursues a goal of its own
    instead; int32 `evaluated_at []`: the step of the last evaluation; `counters`: counts for the metrics.
    """

    key: jax.Array
    env_state: State
    rules: Rules
    attempt_steps: jax.Array
    step: jax.Array
    attempt_age: jax.Array
    task_goal: jax.Array
    goal_is_set: jax.Array
    evaluated_at: jax.Array
    counters: Counters

    @property
    def obs(self) -> jax.Array:
        """The current observation [s + g], on which the agent acts."""
        return self.env_state.obs

    @property
    def has_ended(self) -> jax.Array:
        """Whether the budget for help is spent, bool []; from then on, actions have no effect."""
        return self.env_state.done > 0


class StepResult(NamedTuple):
    """What an agent learns from one step.

    `next_obs [s + g]`: the observation that the step led to, under the goal that the agent pursued and before a reset
    or a goal change; after a fault, the observation before the step. `reward []`: the reward for that goal, 0 after a
    fault. `success []`, bool: `next_obs` has reached its goal. `end`: how the step ended; `end.phase_ended` tells
    whether the attempt ended, `end.env_reset` whether there was an intervention. Those of a `HelpBudget` are part of
    its step: they are not in `end`, and `next_obs` is the new start. `terminated []`: the life has ended.
    """

    next_obs: jax.Array
    reward: jax.Array
    success: jax.Array
    end: StepEnd
    terminated: jax.Array


@package_types()
def init(
    env: Env,
    protocol: Protocol,
    key: jax.Array,
    attempt_steps: int = ATTEMPT_STEPS,
    start: Callable[[jax.Array], State] | None = None,
) -> ProtocolState:
    """Return the life of one lane in `env` before its first step.

    Args:
        env: the task, or a `HelpBudget` (`setting.wrap(task)`).
        protocol: the rules (`setting.protocol(env)`).
        key: a typed key for all random draws of this life.
        attempt_steps: steps after which an attempt at a goal times out, as in naive RL.
        start: `start(key) -> State` returns the first state of the life; by default s0 ~ rho.

    Raises:
        ValueError: `attempt_steps` is less than 1, `env` or `protocol` is another object, such as a setting, or `env`
            fails the checks that training makes, too (`envs.checks.check_task`).
    """
    require_object("task", env, Env, or_name=False)
    require_object("protocol", protocol, Protocol, or_name=False)
    require("attempt_steps", attempt_steps, COUNT)
    check_task(env)
    key, reset_key = jax.random.split(key)
    env_state = (start or env.reset)(reset_key)
    zero = jnp.zeros((), jnp.int32)
    state = ProtocolState(
        key=key,
        env_state=env_state,
        rules=jax.tree.map(jnp.asarray, protocol.rules),
        attempt_steps=jnp.asarray(attempt_steps, jnp.int32),
        step=zero,
        attempt_age=zero,
        task_goal=env_state.info["goal"],
        goal_is_set=jnp.zeros((), bool),
        evaluated_at=zero,
        counters=init_counters(env, env_state),
    )
    return jax.tree.map(jnp.copy, state)  # no array twice, which a jitted step could not donate


@package_types()
def advance(env: Env, state: ProtocolState, action: jax.Array) -> tuple[ProtocolState, StepResult]:
    """Return the life after one control step with `action [a]`, and the `StepResult` to learn from.

    Interventions reset the environment every H_T steps, at random with the protocol's probability, and after a fault of
    the simulation. In the deployment setting a new task goal is drawn when an attempt ends: at success (sparse
    rewards), after `attempt_steps`, and at interventions. In the continuing setting task goals change only on a
    schedule. A goal that the agent has set (`set_goal`) stays. C(A) counts the reward for the task goal, whatever goal
    the agent pursues.
    """
    require_object("state of a life", state, ProtocolState, or_name=False)
    key, chance_key, goal_key, reset_key = jax.random.split(state.key, 4)
    env_state, is_task = env.step(state.env_state, action), ~state.goal_is_set
    earned = env.goal_reward(env_state, state.task_goal)
    attempt = Attempt(
        is_task=is_task,
        expires=state.attempt_age + 1 >= state.attempt_steps,
        ends_on_success=True,
        reset_at_end=False,
        invalid_reward=~jnp.isfinite(earned),
    )
    end = advance_rules(state.rules, env, env_state, attempt, state.step + 1, chance_key)
    draws_goal = jnp.where(state.rules.goal_change > 0, end.goal_changes, end.phase_ended & is_task)
    task_goal = jnp.where(draws_goal, env.sample_goal(goal_key), state.task_goal)
    goal = jnp.where(is_task, task_goal, state.env_state.info["goal"])
    following = state.replace(
        key=key,
        env_state=env.with_goal(reset_where(end.env_reset, env, reset_key, env_state), goal),
        step=state.step + 1,
        attempt_age=jnp.where(end.phase_ended, 0, state.attempt_age + 1),
        task_goal=task_goal,
        counters=count_step(state.counters, env, env_state, attempt, end, earned, state.step + 1),
    )
    return following, _result(env, state, env_state, end)


def _result(env: Env, state: ProtocolState, env_state: State, end: StepEnd) -> StepResult:
    return StepResult(
        next_obs=jnp.where(end.fault, state.obs, env_state.obs),
        reward=jnp.where(end.fault, 0.0, env_state.reward),
        success=env.success(env_state.obs) & ~end.fault,
        end=end,
        terminated=env_state.done > 0,
    )


@package_types()
def set_goal(env: Env, state: ProtocolState, goal: jax.Array | None = None) -> ProtocolState:
    """Return `state` at the start of an attempt at `goal [g]`, which stays until the next `set_goal` or `intervene`.

    Without `goal` the environment chooses again: a new task goal (deployment) or the scheduled one (continuing).

    Raises:
        ValueError: the goal has another shape, or (outside jit) is not finite.
    """
    if goal is not None:
        return _with_goal(env, state, goal, is_set=True)
    key, goal_key = jax.random.split(state.key)
    return _with_task_goal(env, state.replace(key=key), goal_key)


def _with_task_goal(env: Env, state: ProtocolState, key: jax.Array) -> ProtocolState:
    """Return `state` with the goal that the environment chooses, drawn with `key` in the deployment setting."""
    goal = jnp.where(state.rules.goal_change > 0, state.task_goal, env.sample_goal(key))
    return _with_goal(env, state.replace(task_goal=goal), goal, is_set=False)


def _with_goal(env: Env, state: ProtocolState, goal: jax.Array, is_set: bool) -> ProtocolState:
    """Return `state` at the start of an attempt at `goal [g]`; an attempt that has made a step counts as ended."""
    counters, ended = state.counters, (state.attempt_age > 0) & ~state.has_ended
    phases = advance_phase_stats(
        counters.phases, env, state.env_state, ~state.goal_is_set, ended, False, state.step, state.attempt_age - 1
    )
    return state.replace(
        env_state=env.with_goal(state.env_state, goal),
        attempt_age=jnp.zeros_like(state.attempt_age),
        goal_is_set=jnp.full_like(state.goal_is_set, is_set),
        counters=counters.replace(phases=phases),
    )


@package_types()
def intervene(env: Env, state: ProtocolState) -> ProtocolState:
    """Return the life after an intervention by the caller, which is counted: a start s0 ~ rho with a task goal.

    The task goal is drawn anew in the deployment setting and is the scheduled one in the continuing setting. In a life
    that has ended, only the goal changes.
    """
    key, goal_key, reset_key = jax.random.split(state.key, 3)
    env_state = env.intervene(reset_key, state.env_state)
    counters = state.counters.replace(interventions=state.counters.interventions + ~state.has_ended)
    return _with_task_goal(env, state.replace(key=key, env_state=env_state, counters=counters), goal_key)


@package_types()
def evaluate(
    env: Env, protocol: Protocol, state: ProtocolState, policy: Callable[[jax.Array], jax.Array]
) -> tuple[ProtocolState, dict[str, jax.Array]]:
    """Return the life, in which a new evaluation window begins, and scalars of both of the paper's evaluations.

    `deployed/success` and `deployed/return` are the means of `protocol.eval_episodes` episodes of `policy(obs) ->
    action` from s0 ~ rho, without help (`metrics.deployed`). `continuing/reward` is C(A) so far, `continuing/recent`
    the same since the last evaluation; `interventions`, `faults` and `reached` count since the first step. These and
    the metrics of attempts have the names of columns of metrics.csv; attempts at goals that the agent set count as
    return phases.
    """
    metrics = protocol.deployed(env, policy, state.key)
    window, alive = state.step - state.evaluated_at, protocol.alive_steps
    counters, of_life = continuing(state.counters, env, state.env_state, state.step, window, alive, DIRECTIONS)
    return state.replace(evaluated_at=jnp.copy(state.step), counters=counters), {**metrics, **of_life}
