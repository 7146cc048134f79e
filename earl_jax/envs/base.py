"""The contract that every task keeps: `State`, `Env`, and what a goal-conditioned world must answer."""

import abc
import dataclasses
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax.core import Tracer

from earl_jax import assets

REWARD_TYPES = ("sparse", "dense")


class State(struct.PyTreeNode):
    """One moment of a world: physics `data`, `obs [s + g]`, scalar float32 `reward` and `done`, `metrics`, `info`.

    The tree keeps its structure, dtypes and weak types from `reset` on, so it can be a scan's carry.
    """

    data: Any
    obs: jax.Array
    reward: jax.Array
    done: jax.Array
    metrics: dict[str, jax.Array]
    info: dict[str, jax.Array]


@dataclasses.dataclass(frozen=True)
class Env(abc.ABC):
    """A goal-conditioned world without resets: pure `reset` and `step`, unbatched, jittable, hashable.

    Fields are the options of a task; use `dataclasses.replace` for a variant. `obs = concat(state, goal)`, actions lie in
    [-1, 1] and are clipped. An env never resets itself and never ends by itself: that is the protocol's business.
    """

    reward_type: str = "sparse"
    train_horizon: int = 200_000
    eval_horizon: int = 200
    demo_file: str | None = None
    """Demonstrations to use instead of those that ship: an npz of `earl-jax demos` or `earl-jax import-demos`."""

    name: ClassVar[str]
    action_size: ClassVar[int]
    goal_change: ClassVar[int]
    """Steps between goal changes in the paper's continuing setting."""
    continuing_horizon: ClassVar[int | None] = None
    """H_T of the released continuing setting where it differs from `train_horizon`."""
    area: ClassVar[np.ndarray | None] = None
    """What `place` lies in, [[x, y] low, [x, y] high], where a map of visited places says something of this task."""
    ends: ClassVar[bool] = False
    """Whether a life in this world can come to an end, which `State.done` then says."""

    def __post_init__(self):
        self._require("reward_type", REWARD_TYPES)
        for field in ("train_horizon", "eval_horizon"):
            if getattr(self, field) < 1:
                raise ValueError(f"{field} must be at least 1, not {getattr(self, field)}")

    def _require(self, field: str, choices: tuple[str, ...]) -> None:
        """Refuse an option that is not one of its `choices`."""
        if getattr(self, field) not in choices:
            raise ValueError(f"{field} {getattr(self, field)!r} is not one of {', '.join(choices)}")

    @property
    @abc.abstractmethod
    def state_size(self) -> int:
        """Length s of a state."""

    @property
    @abc.abstractmethod
    def goal_size(self) -> int:
        """Length g of a goal."""

    @property
    def engine(self) -> str:
        """What moves this world: a physics engine's name, or `kinematic` for plain arithmetic."""
        return "kinematic"

    @property
    def model(self) -> str:
        """The MJCF that pictures show, its name in assets or its path."""
        return self.name

    def shown(self, state: State) -> Any:
        """Return the `Integration` of `model` that a picture of `state` shows."""
        return state.data

    def shown_goal(self, state: State) -> Any:
        """Return the `Integration` that `shown` would be with the goal of `state` reached, None where nothing marks a goal."""
        del state

    def begun(self, vector: jax.Array, goal: jax.Array) -> State:
        """Return a start at which `vector [s]` is observed and `goal [g]` commanded, for demonstrations to be replayed from.

        Raises:
            ValueError: this task starts from `reset` only.
        """
        raise ValueError(f"{self.name} cannot replay demonstrations: it starts from reset only")

    def for_lanes(self, lanes: int) -> "Env":
        """Return this task with what only the number of lanes can tell decided: for a physics engine `auto`, which one."""
        del lanes
        return self

    @property
    def obs_size(self) -> int:
        """Length of `obs`: state and goal."""
        return self.state_size + self.goal_size

    @property
    def sparse(self) -> bool:
        """Whether the reward is 1 on success and 0 elsewhere, so that reaching a goal ends a virtual episode."""
        return self.reward_type == "sparse"

    @property
    def reward_scale(self) -> float:
        """The learner's factor on this task's reward where none is asked for: 10 for a sparse reward, 1 for a dense one."""
        return 10.0 if self.sparse else 1.0

    @property
    @abc.abstractmethod
    def goal_states(self) -> np.ndarray:
        """Task goals, float32 [G, g]."""

    @property
    @abc.abstractmethod
    def initial_states(self) -> np.ndarray:
        """Representative states of the initial distribution rho, float32 [I, s], in the layout of a goal."""

    @abc.abstractmethod
    def reset(self, key: jax.Array) -> State:
        """Return a state with s0 ~ rho and a task goal drawn uniformly."""

    def _launch(self, state: State, action: jax.Array) -> Any:
        """Return what `_land` goes on from: by default nothing is begun, and that is the clipped `action [a]`."""
        del state
        return action

    @abc.abstractmethod
    def _land(self, state: State, flight: Any) -> tuple[Any, jax.Array, dict[str, jax.Array]]:
        """Return the next physics data, the next state vector [s] and the info fields that changed."""

    @abc.abstractmethod
    def success(self, obs: jax.Array) -> jax.Array:
        """Return whether the state part of `obs [..., s + g]` has reached its goal part, bool [...]."""

    @abc.abstractmethod
    def reward(self, obs: jax.Array) -> jax.Array:
        """Return the reward of arriving in `obs [..., s + g]`, float32 [...]."""

    def fault(self, state: State) -> jax.Array:
        """Return whether the simulation broke on the way to `state`, bool []: something in it is not finite.

        Tasks with a workspace add leaving it. Whoever lives in this world is then put back to s0 ~ rho from outside.
        """
        leaves = [leaf for leaf in jax.tree.leaves((state.data, state.obs)) if jnp.issubdtype(leaf.dtype, jnp.inexact)]
        return ~jnp.stack([jnp.isfinite(leaf).all() for leaf in leaves]).all()

    def irreversible(self, state: State) -> jax.Array:
        """Return whether `state` is one that this body cannot leave and a watcher can tell, bool []: here a `fault` only.

        Nothing follows from it in the plain world; `Helped` enforces an intervention there.
        """
        return self.fault(state)

    def intervene(self, key: jax.Array, state: State) -> State:
        """Return the state after an intervention from outside: s0 ~ rho, with what `state` remembers across one kept."""
        del state
        return self.reset(key)

    def place(self, obs: jax.Array) -> jax.Array:
        """Return where [..., 2] in its `area` the body or thing that a map of this task follows is in `obs [..., s + g]`.

        Raises:
            ValueError: this task has no map.
        """
        raise ValueError(f"{self.name} has no map of visited places")

    def scattered(self, key: jax.Array) -> State:
        """Return a state drawn uniformly over the workspace, with a task goal, as figure 5 of the paper asks for.

        Raises:
            ValueError: this task has no such distribution.
        """
        raise ValueError(f"{self.name} has no uniform distribution of starts")

    @property
    def has_demos(self) -> bool:
        """Whether there are demonstrations of this task."""
        return self.demo_file is not None or assets.has_demos(self.name)

    @property
    def demo_directions(self) -> tuple[str, ...]:
        """The directions of which there are demonstrations."""
        return assets.demo_directions(self.demo_file or self.name)

    def demos(self, direction: str) -> assets.Demos:
        """Return the demonstrations of `direction` (forward or backward) in this task's layout.

        Raises:
            ValueError: there are none, or the file is not one of them; the message lists the choices.
        """
        return assets.demos(self.demo_file or self.name, direction)

    def expert(self, obs: jax.Array) -> jax.Array:
        """Return the action [a] of a scripted controller that reaches the goal in `obs [s + g]`.

        Raises:
            ValueError: this task has no scripted controller.
        """
        raise ValueError(f"{self.name} has no scripted expert")

    def step(self, state: State, action: jax.Array) -> State:
        """Return the state after one control step with `action [a]` in [-1, 1].

        Raises:
            ValueError: the action has another shape, or (outside jit, where values are known) is not finite.
        """
        return self.land(state, self.launch(state, action))

    def launch(self, state: State, action: jax.Array) -> Any:
        """Return the control step from `state` with `action [a]` on its way, a tree of arrays for `land`.

        Between the two a program can do other work while the host simulates; `step` is both in one. Errors as `step`.
        """
        check_action(action, self.action_size)
        return self._launch(state, jnp.clip(jnp.asarray(action, jnp.float32), -1.0, 1.0))

    def land(self, state: State, flight: Any) -> State:
        """Return the state after the control step that `launch` began from `state`."""
        data, vector, changed = self._land(state, flight)
        return self._state(data, vector, {**state.info, **changed})

    def _state(self, data: Any, vector: jax.Array, info: dict[str, jax.Array]) -> State:
        obs = jnp.concatenate([vector, info["goal"]])
        metrics = {"success": self.success(obs).astype(jnp.float32)}
        return State(data, obs, self._arrival_reward(obs, info), jnp.zeros((), jnp.float32), metrics, info)

    def _arrival_reward(self, obs: jax.Array, info: dict[str, jax.Array]) -> jax.Array:
        """Return the reward of arriving in `obs [s + g]` with `info`, where a task's reward depends on more than obs."""
        del info
        return self.reward(obs)

    def sample_goal(self, key: jax.Array) -> jax.Array:
        """Return a task goal [g], uniform over `goal_states`."""
        goals = jnp.asarray(self.goal_states)
        return goals[jax.random.randint(key, (), 0, goals.shape[0])]

    def with_goal(self, state: State, goal: jax.Array) -> State:
        """Return `state` commanded to reach `goal [g]`; reward and metrics still speak of the last transition."""
        obs = jnp.concatenate([state.obs[: self.state_size], goal])
        return state.replace(obs=obs, info={**state.info, "goal": goal})

    def goal_reward(self, state: State, goal: jax.Array) -> jax.Array:
        """Return what `state` would have earned under `goal [g]`, whichever goal is commanded now."""
        return self._arrival_reward(jnp.concatenate([state.obs[: self.state_size], goal]), state.info)


def check_action(action: jax.Array, size: int) -> None:
    """Refuse an action of another shape than [size], or one that is known not to be finite."""
    shape = jnp.shape(action)
    if shape != (size,):
        raise ValueError(f"action has shape {shape}, this task takes ({size},); for a batch of lanes use jax.vmap")
    if not isinstance(action, Tracer) and not np.isfinite(np.asarray(action)).all():
        raise ValueError(f"action is not finite: {np.asarray(action).tolist()}")
