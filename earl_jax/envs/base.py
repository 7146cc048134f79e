"""The interface of every task: the goal-conditioned `Env`, and `KinematicEnv` for tasks of plain arithmetic."""

import abc
import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from earl_jax import assets
from earl_jax.envs.checks import of_state, of_whole_obs, require_like, require_result, require_tuple
from earl_jax.envs.demonstrations import TaskDemos
from earl_jax.envs.features import ContinuingDefaults, Map, Starts, View
from earl_jax.envs.state import NextState, State, all_finite, random_row
from earl_jax.errors import InputError, brief, check_overrides
from earl_jax.options.jax_settings import package_types
from earl_jax.options.values import COUNT, COUNT_OR_NEVER, check, check_intervals, require
from earl_jax.physics import PendingStep

if TYPE_CHECKING:
    from gymnasium.spaces import Box


@dataclasses.dataclass(frozen=True)
class Env(abc.ABC):
    """A goal-conditioned environment without resets: pure `reset` and `step`, unbatched, jittable, hashable.

    Fields are the options of a task; use `dataclasses.replace` for a variant. `obs = concat(state, goal)`. Actions are
    clipped to [-1, 1]. An env never resets itself and never ends an episode: the protocol does both.

    Tasks of plain arithmetic subclass `KinematicEnv`, tasks with a MuJoCo model `MujocoEnv`. Each feature that only
    some tasks have is one attribute: `map`, `starts`, `object_position`, `demonstrations` and `view`.
    """

    reward_type: Literal["sparse", "dense"] = "sparse"
    """The reward: 1 on success and 0 elsewhere (sparse), or shaped (dense)."""
    train_horizon: int = 200_000
    """H_T: steps between hard interventions in training; 0 for never, which the paper defines as full autonomy."""
    eval_horizon: int = 200
    """H_E: steps of an evaluation episode, and of a phase of most methods."""
    demo_file: str | None = None
    """An npz file from `earl-jax demos` or `earl-jax import-demos`, used instead of the demonstrations that ship."""

    name: ClassVar[str]
    has_absorbing_state: ClassVar[bool] = False
    """Whether this environment has an absorbing end state, which `State.done` reports."""

    def __init_subclass__(cls, **options: Any):
        """Run the functions of a task under the package's jax types, as `step` does, and make its arrays read-only."""
        super().__init_subclass__(**options)
        check_overrides(cls)
        if "step" in vars(cls):
            remedy = "override finish_step, or what it calls"
            raise InputError(f"{cls.__name__}.step: training calls start_step and finish_step instead; {remedy}")
        if "reset" in vars(cls):
            cls.reset = package_types()(of_state(cls.reset))
        for name in {"success", "reward"} & vars(cls).keys():
            setattr(cls, name, package_types()(of_whole_obs(getattr(cls, name))))
        for constant in vars(cls).values():
            if isinstance(constant, np.ndarray):
                constant.setflags(write=False)

    def __post_init__(self):
        given = {field: getattr(self, field.name) for field in dataclasses.fields(self)}
        options = {field.name: value for field, value in given.items() if value is not field.default}
        check(type(self).__name__, type(self), options)
        check_intervals(type(self).__name__, self)
        require("train_horizon", self.train_horizon, COUNT_OR_NEVER)
        require("eval_horizon", self.eval_horizon, COUNT)

    @property
    @abc.abstractmethod
    def state_size(self) -> int:
        """Length s of a state."""

    @property
    @abc.abstractmethod
    def action_size(self) -> int:
        """Length a of an action."""

    @property
    def goal_size(self) -> int:
        """Length g of a goal."""
        return self.goal_states.shape[1]

    @property
    def observation_size(self) -> int:
        """Length s + g of `obs`, the state followed by the goal."""
        return self.state_size + self.goal_size

    @property
    def observation_space(self) -> "Box":
        """Gymnasium's space of `obs`, float32 [s + g] without bounds."""
        return _box(np.inf, self.observation_size)

    @property
    def action_space(self) -> "Box":
        """Gymnasium's space of actions, float32 [a] in [-1, 1]."""
        return _box(1.0, self.action_size)

    @property
    def sparse(self) -> bool:
        """Whether the reward is 1 on success and 0 elsewhere. If it is, reaching a goal ends a virtual episode."""
        return self.reward_type == "sparse"

    @property
    def reward_scale(self) -> float:
        """The learner's default factor on this task's reward: 10 for a sparse reward, 1 for a dense one."""
        return 10.0 if self.sparse else 1.0

    @property
    @abc.abstractmethod
    def goal_states(self) -> np.ndarray:
        """Task goals, float32 [G, g]."""

    @property
    @abc.abstractmethod
    def initial_states(self) -> np.ndarray:
        """Representative states of the initial distribution rho in the layout of a goal, float32 [I, g]."""

    @abc.abstractmethod
    def reset(self, key: jax.Array) -> State:
        """Return a start s0 ~ rho with a task goal that is drawn uniformly; its observation must be finite."""

    @abc.abstractmethod
    def success(self, obs: jax.Array) -> jax.Array:
        """Return whether the state part of `obs [..., s + g]` has reached its goal part, bool [...]."""

    @abc.abstractmethod
    def reward(self, obs: jax.Array) -> jax.Array:
        """Return the reward of arriving in `obs [..., s + g]`, float32 [...]."""

    def fault(self, state: State) -> jax.Array:
        """Return whether the simulation broke in the step to `state`, bool []: its data, obs or reward is not finite.

        Tasks with a workspace also report a body outside it. After a fault, training resets the lane to s0 ~ rho.
        """
        return ~all_finite((state.data, state.obs, state.reward))

    def irreversible(self, state: State) -> jax.Array:
        """Return whether the agent can never leave `state` by itself, bool []; by default only after a `fault`.

        The plain environment does nothing about such a state. `HelpBudget` enforces an intervention.
        """
        return self.fault(state)

    def intervene(self, key: jax.Array, state: State) -> State:
        """Return the state after a hard intervention: by default a start s0 ~ rho, which keeps nothing of `state`."""
        return self.reset(key)

    @property
    def continuing(self) -> ContinuingDefaults:
        """The task's numbers in the paper's continuing setting, by default a goal change every 2 H_E steps."""
        return ContinuingDefaults(goal_change=2 * self.eval_horizon)

    @property
    def map(self) -> Map | None:
        """The map of visited positions; None if the task has no map."""
        return None

    @property
    def starts(self) -> Starts:
        """Further distributions of starts besides s0 ~ rho, by default none."""
        return Starts()

    @property
    def view(self) -> View | None:
        """How the task is drawn; None for a task without pictures."""
        return None

    @property
    def demonstrations(self) -> TaskDemos:
        """The demonstrations: by default recorded ones alone, without a scripted expert or a script to record more."""
        return TaskDemos(assets.asset_name(self), self.demo_file, (self.state_size, self.goal_size, self.action_size))

    @property
    def object_position(self) -> Callable[[State], jax.Array] | None:
        """A function from a state to the noise-free position [k] of the object to move; None if there is no object.

        The metric `continuing/still_steps` counts the steps since the object last moved.
        """
        return None

    @package_types()
    def step(self, state: State, action: jax.Array) -> State:
        """Return the state after one control step with `action [a]` in [-1, 1].

        Raises:
            ValueError: the action has another shape or (outside jit) is not finite, or `state` is not a `State`.
        """
        if not isinstance(state, State):
            raise InputError(f"{self.name}: step takes the State that reset or step returned, not {brief(state)}")
        return self.finish_step(state, self.start_step(state, action))

    @abc.abstractmethod
    def start_step(self, state: State, action: jax.Array) -> PendingStep:
        """Start a control step from `state` with `action [a]`, and return the pending step for `finish_step`.

        A program can do other work between the two calls while the host simulates. Errors as `step`.
        """

    @abc.abstractmethod
    def finish_step(self, state: State, pending: PendingStep) -> State:
        """Return the state after the control step that `start_step` started from `state`."""

    def _checked_action(self, action: jax.Array) -> jax.Array:
        """Return `action [a]` as float32 clipped to [-1, 1]. Errors as `step`."""
        return jnp.clip(_checked("action", action, self.action_size), -1.0, 1.0)

    def _next_state(self, state: State, action: jax.Array, following: NextState) -> State:
        """Return the `State` after a control step from `state` with `action [a]` and the result `following`.

        If the action is not finite, obs becomes NaN, which is a fault; MuJoCo would replace such an action silently.
        """
        data, vector, changed = require_tuple(f"{self.name}: a step", following, tuple, "data", "vector", "info")
        if new := changed.keys() - state.info.keys():
            given = f"{', '.join(sorted(new))} in info, which reset must set too; reset sets {', '.join(state.info)}"
            raise InputError(f"{self.name}: a step sets {given}")
        after = self.make_state(data, vector, {**state.info, **changed})
        require_like(f"{self.name}: a step must return the state", after, state)
        return after.replace(obs=jnp.where(jnp.isfinite(action).all(), after.obs, jnp.nan))

    def make_state(self, data: Any, vector: jax.Array, info: dict[str, jax.Array]) -> State:
        """Return the `State` with physics `data`, state vector `vector [s]` and `info`, which holds the `goal [g]`.

        Raises:
            ValueError: the vector has another shape.
        """
        if jnp.shape(vector) != (self.state_size,):
            raise InputError(f"{self.name}: a state vector has shape {jnp.shape(vector)}, not {(self.state_size,)}")
        if "goal" not in info:
            raise InputError(f"{self.name}: info of make_state must have the goal, not only {brief(list(info))}")
        obs, zero = jnp.concatenate([vector, info["goal"]]), jnp.zeros(())
        metrics = {"success": self.success(obs).astype(jnp.float32)}
        state = State(data=data, obs=obs, reward=zero, done=zero, metrics=metrics, info=info)
        reward = self.goal_reward(state, info["goal"])
        require_result(f"{self.name}: what goal_reward returns", reward, (), "number")
        return state.replace(reward=jnp.asarray(reward, jnp.float32))

    @package_types()
    def sample_goal(self, key: jax.Array) -> jax.Array:
        """Return a task goal [g], uniform over `goal_states`."""
        return random_row(key, np.asarray(self.goal_states, np.float32))

    def with_goal(self, state: State, goal: jax.Array) -> State:
        """Return `state` with a copy of `goal [g]` as its goal; reward and metrics still describe the last transition.

        Raises:
            ValueError: the goal has another shape, or (outside jit, where values are known) is not finite.
        """
        goal = _checked("goal", goal, self.goal_size)
        obs = jnp.concatenate([state.obs[: self.state_size], goal])
        return state.replace(obs=obs, info={**state.info, "goal": goal})

    def goal_reward(self, state: State, goal: jax.Array) -> jax.Array:
        """Return the reward that the step to `state` earns under `goal [g]`, which need not be the goal of `state`.

        Override it if the reward depends on parts of `state` that its obs does not contain.
        """
        return self.reward(self.with_goal(state, goal).obs)


def _checked(name: str, values: jax.Array, size: int) -> jax.Array:
    """Return a copy of `values [size]` as float32. Errors as `Env.step`."""
    if (shape := np.shape(values)) != (size,):
        raise InputError(f"{name} has shape {shape}, this task takes {(size,)}; for a batch of lanes use jax.vmap")
    if not isinstance(values, Tracer) and not np.isfinite(np.asarray(values, np.float32)).all():
        raise InputError(f"{name} is not finite: {np.asarray(values).tolist()}")
    return jnp.array(values, jnp.float32)


def _box(bound: float, size: int) -> "Box":
    """Return the float32 space [-bound, bound]^size."""
    from gymnasium.spaces import Box  # takes time to import

    return Box(-bound, bound, (size,), np.float32)


@dataclasses.dataclass(frozen=True)
class KinematicEnv(Env):
    """A task of plain arithmetic, without a physics engine.

    A subclass defines `name`, `state_size`, `action_size`, `goal_states`, `initial_states`, `reset`, `transition`,
    `success` and `reward`.
    """

    @abc.abstractmethod
    def transition(self, state: State, action: jax.Array) -> NextState:
        """Return the result of a control step from `state` with the clipped `action [a]`."""

    def start_step(self, state: State, action: jax.Array) -> PendingStep:
        return PendingStep(self._checked_action(action))

    def finish_step(self, state: State, pending: PendingStep) -> State:
        action = pending.payload
        return self._next_state(state, action, self.transition(state, action))
