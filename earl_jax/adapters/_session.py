"""A task for agents of other libraries: one lifetime with interventions and goal changes, or evaluation episodes.

The rules are those of `earl_jax.protocol`, as in the training loop.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from earl_jax.envs import Env, State, make, start_of
from earl_jax.envs.starts import STARTS
from earl_jax.envs.state import tree_where
from earl_jax.envs.wrappers.without_help import without_help
from earl_jax.errors import InputError
from earl_jax.protocol import (
    Attempt,
    Deployment,
    Protocol,
    Setting,
    advance_rules,
    reset_where,
    setting_of,
    split_setting,
    with_explicit_horizon,
)

MODES = ("train", "eval")
ATTEMPT_STEPS = 1000
"""Steps after which naive RL gives up a goal that it has not reached (Sharma et al. 2022, section 5.1)."""


class SessionState(struct.PyTreeNode):
    """The state of one lane.

    `key` of all future draws; `env_state`; int32 `steps` of the lifetime or the episode; int32 `attempt_age`: steps
    since the goal was drawn; int32 `interventions`; bool `goal_is_set`: the caller set the goal; bool `reached`: a step
    of the lifetime or the episode reached its goal.
    """

    key: jax.Array
    env_state: State
    steps: jax.Array
    attempt_age: jax.Array
    interventions: jax.Array
    goal_is_set: jax.Array
    reached: jax.Array


class StepResult(NamedTuple):
    """The result of a step or a reset: `obs [s + g]`, and scalars.

    `success`: the step reached the goal that it was made under. `reached`: so did a step of this episode. `terminated`:
    the lifetime ended. `truncated`: the episode is over. `fault`: the simulation broke, and the reward is 0.
    """

    obs: Any
    reward: Any
    success: Any
    reached: Any
    terminated: Any
    truncated: Any
    fault: Any
    interventions: Any


@dataclasses.dataclass(frozen=True)
class Session:
    """`env` under `protocol`: pure functions of one lane, for jit and vmap.

    Mode `train` is one lifetime. A hard intervention comes every H_T steps, with the protocol's chance, and after a
    fault of the simulation. In a deployment setting the task goal changes when it is reached (sparse rewards), after
    `attempt_steps`, and at interventions, as for naive RL; in the continuing setting it changes on a schedule only.
    Mode `eval` is episodes of H_E steps from s0 ~ rho with one goal each. A fault truncates an episode in its last
    state before the fault; with a budget, help has no effect in them and nothing is charged. A goal that the caller sets
    stays until the next `set_goal`, `draw_goal` or reset.
    """

    env: Env
    protocol: Protocol
    mode: str = "train"
    attempt_steps: int = ATTEMPT_STEPS
    starts: str = STARTS[0]
    """The distribution of an episode's start, one of `envs.starts.STARTS`."""

    def __post_init__(self):
        if self.mode not in MODES:
            raise InputError(f"mode {self.mode!r} is not one of {', '.join(MODES)}")
        if self.attempt_steps < 1:
            raise InputError(f"attempt_steps must be at least 1, not {self.attempt_steps}")
        if self.is_training and self.starts != STARTS[0]:
            raise InputError(f"starts={self.starts!r} is for episodes, mode 'eval'; a lifetime starts from s0 ~ rho")
        start_of(self.env, self.starts)

    @classmethod
    def of(
        cls,
        task: str | Env,
        lanes: int = 1,
        mode: str = "train",
        setting: str | Setting = Deployment.name,
        attempt_steps: int = ATTEMPT_STEPS,
        starts: str = STARTS[0],
        **options: Any,
    ) -> "Session":
        """Return the session of `task`, a name with its `options` or an `Env`, for a batch of `lanes`.

        Raises:
            ValueError: an unknown name or option, or options beside an `Env`; the message lists the choices.
        """
        setting = setting_of(setting) if isinstance(setting, str) else setting
        env, setting = split_setting(_make_task(task, options), setting)
        setting, env = with_explicit_horizon(setting, env, options), setting.wrap(env.for_lanes(lanes))
        return cls(env if mode == "train" else without_help(env), setting.protocol(env), mode, attempt_steps, starts)

    @property
    def is_training(self) -> bool:
        """Whether this is one lifetime rather than episodes."""
        return self.mode == "train"

    def start(self, seed: jax.Array) -> SessionState:
        """Return the start of a lifetime or of the first episode, from a `seed`: uint32 []."""
        return self.start_from_key(jax.random.key(seed))

    def start_from_key(self, key: jax.Array) -> SessionState:
        """Return what `start` returns, from a typed key."""
        key, reset_key = jax.random.split(key)
        zero, false = jnp.zeros((), jnp.int32), jnp.zeros((), bool)
        return SessionState(
            key=key,
            env_state=start_of(self.env, self.starts)(reset_key),
            steps=zero,
            attempt_age=zero,
            interventions=zero,
            goal_is_set=false,
            reached=false,
        )

    def reset(self, state: SessionState) -> SessionState:
        """Return the start of the next episode, or the lifetime after an intervention from outside.

        A lifetime that has ended starts again.
        """
        fresh = self.start_from_key(state.key)
        if not self.is_training:
            return fresh
        key, goal_key, reset_key = jax.random.split(state.key, 3)
        draws_goal = state.goal_is_set | (self.protocol.goal_change == 0)
        goal = jnp.where(draws_goal, self.env.sample_goal(goal_key), state.env_state.info["goal"])
        intervened = state.replace(
            key=key,
            env_state=self.env.with_goal(self.env.intervene(reset_key, state.env_state), goal),
            attempt_age=jnp.zeros_like(state.attempt_age),
            interventions=state.interventions + 1,
            goal_is_set=jnp.zeros_like(state.goal_is_set),
        )
        return tree_where(state.env_state.done > 0, fresh, intervened)

    def reset_result(self, state: SessionState) -> StepResult:
        """Return the result of a reset that led to `state`."""
        false = jnp.zeros((), bool)
        return _result(state, reward=jnp.zeros(()), success=false, truncated=false, fault=false)

    def step(self, state: SessionState, action: jax.Array) -> tuple[SessionState, StepResult]:
        """Return the state and the result after one control step with `action [a]`."""
        next_env_state = self.env.step(state.env_state, action)
        fault = self.env.fault(next_env_state)
        success = self.env.success(next_env_state.obs) & ~fault
        state = state.replace(steps=state.steps + 1, reached=state.reached | success)
        if self.is_training:
            state = self._advance_lifetime(state, next_env_state)
            truncated = jnp.zeros((), bool)
        else:
            state = state.replace(env_state=tree_where(fault, state.env_state, next_env_state))
            truncated = fault | (state.steps >= self.protocol.eval_horizon)
        reward = jnp.where(fault, 0.0, next_env_state.reward)
        return state, _result(state, reward=reward, success=success, truncated=truncated, fault=fault)

    def _advance_lifetime(self, state: SessionState, next_env_state: State) -> SessionState:
        """Return the state after step number `state.steps` led to `next_env_state`: interventions and goal changes."""
        key, chance_key, goal_key, reset_key = jax.random.split(state.key, 4)
        attempt = Attempt(
            is_task=True,
            expires=state.attempt_age + 1 >= self.attempt_steps,
            ends_on_success=True,
            reset_at_end=False,
        )
        end = advance_rules(self.protocol.rules, self.env, next_env_state, attempt, state.steps, chance_key)
        new_goal = (end.goal_changes if self.protocol.goal_change else end.phase_ended) & ~state.goal_is_set
        goal = jnp.where(new_goal, self.env.sample_goal(goal_key), state.env_state.info["goal"])
        return state.replace(
            key=key,
            env_state=self.env.with_goal(reset_where(end.env_reset, self.env, reset_key, next_env_state), goal),
            attempt_age=jnp.where(new_goal, 0, state.attempt_age + 1),
            interventions=state.interventions + end.env_reset,
        )

    def set_goal(self, state: SessionState, goal: jax.Array, mask: jax.Array) -> SessionState:
        """Return `state`, where `mask` with `goal [g]`, which stays until the next `set_goal`, `draw_goal` or reset."""
        return tree_where(mask, self._with_goal(state, goal, is_set=True), state)

    def draw_goal(self, state: SessionState, mask: jax.Array) -> SessionState:
        """Return `state`, where `mask` with a task goal drawn uniformly, which the rules change again."""
        key, goal_key = jax.random.split(state.key)
        drawn = self._with_goal(state, self.env.sample_goal(goal_key), is_set=False)
        return tree_where(mask, drawn.replace(key=key), state)

    def _with_goal(self, state: SessionState, goal: jax.Array, is_set: bool) -> SessionState:
        return state.replace(
            env_state=self.env.with_goal(state.env_state, goal),
            attempt_age=jnp.zeros_like(state.attempt_age),
            goal_is_set=jnp.full_like(state.goal_is_set, is_set),
        )

    def step_or_reset(
        self, state: SessionState, action: jax.Array, reset: jax.Array
    ) -> tuple[SessionState, StepResult]:
        """Return the state and the result of `step`, or of a reset where `reset`."""
        fresh = self.reset(state)
        return tree_where(reset, (fresh, self.reset_result(fresh)), self.step(state, action))

    def step_and_reset(self, state: SessionState, action: jax.Array) -> tuple[SessionState, StepResult, StepResult]:
        """Return the state and the result of `step`, or of the reset after it where it ended an episode or a lifetime.

        The last item is the result of the step itself.
        """
        state, last = self.step(state, action)
        fresh = self.reset(state)
        over = last.truncated | last.terminated
        state, result = tree_where(over, (fresh, self.reset_result(fresh)), (state, last))
        return state, result, last

    def restart(
        self, state: SessionState, seed: jax.Array, from_seed: jax.Array, mask: jax.Array
    ) -> tuple[SessionState, StepResult]:
        """Return `state`, where `mask` started from `seed` (where `from_seed`) or reset, and the result."""
        state = tree_where(mask, tree_where(from_seed, self.start(seed), self.reset(state)), state)
        return state, self.reset_result(state)


def _result(state: SessionState, **of_step: jax.Array) -> StepResult:
    """Return the result of a step or a reset that led to `state`."""
    return StepResult(
        obs=state.env_state.obs,
        reached=state.reached,
        terminated=state.env_state.done > 0,
        interventions=state.interventions,
        **of_step,
    )


def _make_task(task: str | Env, options: dict[str, Any]) -> Env:
    if isinstance(task, Env):
        if options:
            raise InputError(
                f"options {', '.join(options)} go with a task's name; for an Env object use dataclasses.replace"
            )
        return task
    known, options = [field.name for field in dataclasses.fields(make(task))], dict(options)
    for option in options:
        if option not in known:
            choices = ", ".join(["mode", "setting", "attempt_steps", "starts", *known])
            raise InputError(f"env {task!r} has no option {option!r}; choose from {choices}")
    return make(task, **options)


@functools.cache
def jitted(session: Session, name: str, batched: bool = False) -> Callable:
    """Return the method `name` of `session` under jit, for one lane or over a leading axis of lanes."""
    method = getattr(session, name)
    return jax.jit(jax.vmap(method) if batched else method)


def checked_array(name: str, values: Any, shape: tuple[int, ...]) -> np.ndarray:
    """Return `values` as a float32 array.

    Raises:
        ValueError: they have another shape than `shape`, or are not finite.
    """
    array = np.asarray(values, np.float32)
    if array.shape != shape or not np.isfinite(array).all():
        raise InputError(f"{name} must be finite and of shape {shape}, not {array.tolist()}")
    return array
