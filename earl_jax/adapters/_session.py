"""A task for agents of other libraries: one life under the protocol, or evaluation episodes, by pure functions.

A life consists of the functions of `earl_jax.protocol`: `init`, `advance`, `intervene` and `set_goal`.
"""

import contextlib
import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.envs import Env, env_class, for_lanes, make, start_of
from earl_jax.envs.checks import check_task
from earl_jax.envs.help_budget import without_help
from earl_jax.envs.starts import EVAL_PAIRS, STARTS
from earl_jax.envs.state import tree_where
from earl_jax.errors import InputError, brief, require_known
from earl_jax.options.forks import require_jax
from earl_jax.options.jax_settings import package_types
from earl_jax.options.values import COUNT, require
from earl_jax.protocol import (
    SETTINGS,
    Deployment,
    Protocol,
    ProtocolState,
    Setting,
    advance,
    init,
    intervene,
    set_goal,
    setting_of,
    split_setting,
    with_explicit_horizon,
)
from earl_jax.protocol.life import ATTEMPT_STEPS


class Outputs(NamedTuple):
    """What a step or a reset returns to another library: `obs` and `next_obs [s + g]`, and scalars.

    `next_obs`: where the step led, under its own goal, whereas `obs` can come after an intervention and have a new goal.
    `success`: the step reached the goal that the agent pursued. `reached`: some step of this episode did. `terminated`:
    the life ended. `truncated`: the episode is over. `fault`: the simulation broke, and the reward is 0.
    """

    obs: Any
    next_obs: Any
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

    Mode `train` is one life. Mode `eval` is episodes of H_E steps from s0 ~ rho with one goal each. A fault truncates
    an episode in its last state before the fault. In episodes with a budget, help has no effect and nothing is charged.
    A goal that the caller sets stays until the next `set_goal` or reset.
    """

    env: Env
    protocol: Protocol
    mode: str
    attempt_steps: int
    starts: str
    """The distribution of an episode's start, one of `envs.starts.STARTS`."""

    def __post_init__(self):
        require_jax()
        require_known("mode", self.mode, ("train", "eval"))
        require("attempt_steps", self.attempt_steps, COUNT)
        if self.is_training and self.starts != STARTS[0]:
            raise InputError(f"starts={self.starts!r} is for episodes, mode 'eval'; a lifetime starts from s0 ~ rho")
        if not self.is_training and self.protocol.eval_pairs != EVAL_PAIRS[0]:
            raise InputError(
                f"eval_pairs={self.protocol.eval_pairs!r} is for evaluations of a run; episodes have random pairs"
            )
        start_of(self.env, self.starts)
        check_task(self.env)

    @classmethod
    def of(
        cls,
        task: str | Env,
        lanes: int = 1,
        /,
        mode: str = "train",
        setting: str | Setting = Deployment.name,
        attempt_steps: int = ATTEMPT_STEPS,
        starts: str = STARTS[0],
        **options: Any,
    ) -> "Session":
        """Return the session of `task`, a name with its `options` or an `Env`, for a batch of `lanes`.

        Raises:
            ValueError: a name or option is unknown, or options are given with an `Env`; the message lists the choices.
        """
        env, setting = split_setting(_given_task(task, options), setting_of(setting))
        setting, env = with_explicit_horizon(setting, env, options), setting.wrap(for_lanes(env, lanes))
        return cls(env if mode == "train" else without_help(env), setting.protocol(env), mode, attempt_steps, starts)

    @property
    def is_training(self) -> bool:
        """Whether this is one life rather than episodes."""
        return self.mode == "train"

    def start(self, seed: jax.Array) -> tuple[ProtocolState, Outputs]:
        """Return the start of a life or of the first episode, and its outputs, from a `seed`: uint32 []."""
        return self.start_from_key(jax.random.key(seed))

    def start_from_key(self, key: jax.Array) -> tuple[ProtocolState, Outputs]:
        """Return the same as `start`, but from a typed key."""
        state = init(self.env, self.protocol, key, self.attempt_steps, start_of(self.env, self.starts))
        return state, self._outputs(state)

    def reset(self, state: ProtocolState) -> tuple[ProtocolState, Outputs]:
        """Return the start of the next episode, or the life after an intervention, and the outputs.

        If the life has ended, a new one starts.
        """
        fresh, outputs = self.start_from_key(state.key)
        if not self.is_training:
            return fresh, outputs
        state = tree_where(state.has_ended, fresh, intervene(self.env, state))
        return state, self._outputs(state)

    def _outputs(self, state: ProtocolState, **of_step: jax.Array) -> Outputs:
        """Return the outputs of a step to `state` with the values `of_step`; without values, the outputs of a reset."""
        false = jnp.zeros((), bool)
        values = {"reward": jnp.zeros((), jnp.float32), "success": false, "truncated": false, "fault": false}
        values |= {"next_obs": state.obs, **of_step}
        return Outputs(
            obs=state.obs,
            reached=state.counters.reached > 0,
            terminated=state.has_ended,
            interventions=state.counters.interventions,
            **values,
        )

    def step(self, state: ProtocolState, action: jax.Array) -> tuple[ProtocolState, Outputs]:
        """Return the state and the outputs after one control step with `action [a]`."""
        if not self.is_training:
            return self._step_episode(state, action)
        state, result = advance(self.env, state, action)
        of_step = {"reward": result.reward, "success": result.success, "fault": result.end.fault}
        return state, self._outputs(state, next_obs=result.next_obs, **of_step)

    def _step_episode(self, state: ProtocolState, action: jax.Array) -> tuple[ProtocolState, Outputs]:
        env_state = self.env.step(state.env_state, action)
        fault = self.env.fault(env_state)
        success = self.env.success(env_state.obs) & ~fault
        state = state.replace(
            step=state.step + 1,
            env_state=tree_where(fault, state.env_state, env_state),
            counters=state.counters.replace(reached=state.counters.reached + success),
        )
        truncated = fault | (state.step >= self.protocol.eval_horizon)
        reward = jnp.where(fault, 0.0, env_state.reward)
        return state, self._outputs(state, reward=reward, success=success, truncated=truncated, fault=fault)

    def set_goal(self, state: ProtocolState, goal: jax.Array | None, mask: jax.Array) -> ProtocolState:
        """Return `state`; where `mask` is true, the goal is `goal [g]` or, for None, the environment's choice."""
        return tree_where(mask, set_goal(self.env, state, goal), state)

    def step_or_reset(self, state: ProtocolState, action: jax.Array, reset: jax.Array) -> tuple[ProtocolState, Outputs]:
        """Return the state and the outputs of `step`, or of a reset where `reset` is true."""
        return tree_where(reset, self.reset(state), self.step(state, action))

    def step_and_reset(self, state: ProtocolState, action: jax.Array) -> tuple[ProtocolState, Outputs, Outputs]:
        """Return the state and the outputs of `step`, or of a following reset if the step ended an episode or a life.

        The last item is the outputs of the step itself.
        """
        state, last = self.step(state, action)
        state, outputs = tree_where(last.truncated | last.terminated, self.reset(state), (state, last))
        return state, outputs, last

    def restart(
        self, state: ProtocolState, seed: jax.Array, from_seed: jax.Array, mask: jax.Array
    ) -> tuple[ProtocolState, Outputs]:
        """Return `state`, where `mask` is true started from `seed` (if `from_seed`) or else reset, and the outputs."""
        fresh, _ = tree_where(from_seed, self.start(seed), self.reset(state))
        state = tree_where(mask, fresh, state)
        return state, self._outputs(state)


def _given_task(task: str | Env, options: dict[str, Any]) -> Env:
    if not isinstance(task, Env):
        return make_task(task, options, ("mode", "setting", "attempt_steps", "starts"))
    if options:
        raise InputError(
            f"options {', '.join(options)} go with a task's name; for an Env object use dataclasses.replace"
        )
    return task


def make_task(name: str, options: dict[str, Any], others: Sequence[str]) -> Env:
    """Return the task `name` with its `options`; an InputError of an unknown one lists them and the `others` of the adapter."""
    known = [field.name for field in dataclasses.fields(env_class(name))]
    unknown = [option for option in options if option not in known]
    if not unknown:
        return make(name, **options)
    option = unknown[0]
    for setting in SETTINGS.values() if "setting" in others else ():
        if option in {field.name for field in dataclasses.fields(setting)}:
            text = f"setting=earl_jax.{setting.__name__}({option}=...)"
            raise InputError(f"{option!r} is an option of the setting, not of task {name!r}: pass {text}")
    raise InputError(f"task {name!r} has no option {option!r}; choose from {', '.join([*others, *known])}")


@functools.cache
def jitted(owner: Session | Env, name: str, batched: bool = False) -> Callable:
    """Return the method `name` of a session or a task under jit, for one lane or over a leading axis of lanes."""
    method = package_types()(getattr(owner, name))
    return jax.jit(jax.vmap(method) if batched else method)


def checked_array(name: str, values: Any, shape: tuple[int, ...]) -> np.ndarray:
    """Return `values` as a float32 array.

    Raises:
        ValueError: they are not real numbers, do not have the shape `shape`, or are not finite.
    """
    array = None
    with contextlib.suppress(TypeError, ValueError), np.errstate(over="ignore"):
        array = np.asarray(values).astype(np.float32, casting="same_kind", copy=False)
    if array is None or array.shape != shape or not np.isfinite(array).all():
        raise InputError(f"{name} must be finite and of shape {shape}, not {brief(values)}")
    return array
