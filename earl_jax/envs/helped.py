"""Irreversible states: any task with a budget for interventions, an action that asks for help, and an end when it is spent.

Source: Sharma et al. 2022, appendix on irreversible states. docs/irreversible.md says it in equations.
"""

import dataclasses
import math
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax import assets
from earl_jax.envs.base import Env, State

ROUNDING = 4 * float(np.finfo(np.float32).eps)
"""The share of a budget that float32 can leave over of one that is spent exactly."""


@dataclasses.dataclass(frozen=True)
class Helped(Env):
    """`task` in the augmented spaces: `obs` = task state, share of the budget left, goal; `action` = the task's, help.

    A last component above `help_above` asks for help: the body does not move, what was simulated is discarded, the next state
    is s' ~ rho and the budget, `budget` (h_max) at first, falls by `help_cost`. A step into a state that is irreversible for
    the task is followed by an intervention of the environment, again s' ~ rho, for `enforced_cost`. Both are transitions that an
    agent learns from; the goal that was commanded stays. Where an intervention costs something and leaves nothing of the budget
    it is not given: the life has ended, `done` is 1, the budget 0, the world stays as it was before that step, and every step
    from then on earns `absorbed_reward`. With a threshold of 0.98 one uniform action in a hundred asks.
    """

    reward_type: str = dataclasses.field(init=False, repr=False)
    train_horizon: int = dataclasses.field(init=False, repr=False)
    eval_horizon: int = dataclasses.field(init=False, repr=False)
    demo_file: str | None = dataclasses.field(init=False, repr=False)
    task: Env
    budget: float
    help_cost: float = 1.0
    enforced_cost: float = 1.0
    help_above: float = 0.98
    absorbed_reward: float = 0.0

    ends: ClassVar[bool] = True

    def __post_init__(self):
        if not isinstance(self.task, Env) or isinstance(self.task, Helped):
            raise ValueError(f"task must be an env without a budget of its own, not {self.task!r}")
        for field in dataclasses.fields(Env):
            object.__setattr__(self, field.name, getattr(self.task, field.name))
        super().__post_init__()
        if not (self.budget > 0 and math.isfinite(self.budget)):
            raise ValueError(f"budget must be above 0 and finite, not {self.budget}")
        for field in ("help_cost", "enforced_cost"):
            if not (getattr(self, field) >= 0 and math.isfinite(getattr(self, field))):
                raise ValueError(f"{field} must be at least 0 and finite, not {getattr(self, field)}")
        if not -1 <= self.help_above < 1:
            raise ValueError(f"help_above must lie in [-1, 1), not {self.help_above}")
        if not math.isfinite(self.absorbed_reward) or (self.task.sparse and self.absorbed_reward):
            kind = "0 with a sparse reward, which is a success bit" if self.task.sparse else "finite"
            raise ValueError(f"absorbed_reward must be {kind}, not {self.absorbed_reward}")

    @property
    def name(self) -> str:
        return self.task.name

    @property
    def action_size(self) -> int:
        return self.task.action_size + 1

    @property
    def goal_change(self) -> int:
        return self.task.goal_change

    @property
    def continuing_horizon(self) -> int | None:
        return self.task.continuing_horizon

    @property
    def area(self) -> np.ndarray | None:
        return self.task.area

    @property
    def state_size(self) -> int:
        return self.task.state_size + 1

    @property
    def goal_size(self) -> int:
        return self.task.goal_size

    @property
    def engine(self) -> str:
        return self.task.engine

    @property
    def model(self) -> str:
        return self.task.model

    def shown(self, state: State) -> Any:
        return self.task.shown(state.data)

    def shown_goal(self, state: State) -> Any:
        return self.task.shown_goal(state.data)

    def for_lanes(self, lanes: int) -> "Helped":
        return dataclasses.replace(self, task=self.task.for_lanes(lanes))

    @property
    def sparse(self) -> bool:
        return self.task.sparse

    @property
    def reward_scale(self) -> float:
        return self.task.reward_scale

    @property
    def goal_states(self) -> np.ndarray:
        return self.task.goal_states

    @property
    def initial_states(self) -> np.ndarray:
        return self.task.initial_states

    def sample_goal(self, key: jax.Array) -> jax.Array:
        return self.task.sample_goal(key)

    def reset(self, key: jax.Array) -> State:
        inner_key, own_key = jax.random.split(key)
        return self._newborn(self.task.reset(inner_key), own_key)

    def scattered(self, key: jax.Array) -> State:
        inner_key, own_key = jax.random.split(key)
        return self._newborn(self.task.scattered(inner_key), own_key)

    def _newborn(self, inner: State, key: jax.Array) -> State:
        """Return the state of a life that begins in the task's state `inner` with its whole budget.

        Its `info` counts the interventions that were `asked` for and `enforced`, the one that ended the life among them, and
        keeps the `key` that s' ~ rho is drawn with.
        """
        none = jnp.zeros((), jnp.int32)
        info = {
            "goal": inner.info["goal"],
            "budget": jnp.asarray(self.budget, jnp.float32),
            "asked": none,
            "enforced": none,
        }
        return self._seen(inner, {**info, "key": jax.random.key_data(key)})

    def intervene(self, key: jax.Array, state: State) -> State:
        """Return the state after an intervention from outside: s0 ~ rho for nothing, with budget and counts as they were.

        It revives nobody: where the life has ended, it is `state`.
        """
        inner = self.task.intervene(key, state.data)
        fresh = self._seen(inner, {**state.info, "goal": inner.info["goal"]})
        return _chosen(_ended(state.info), state, fresh)

    def fault(self, state: State) -> jax.Array:
        """Return false: a fault of the task has been answered by an intervention before anybody sees its state."""
        del state
        return jnp.zeros((), bool)

    def _launch(self, state: State, action: jax.Array) -> Any:
        return action[-1] > self.help_above, self.task.launch(state.data, action[:-1])

    def _land(self, state: State, flight: Any) -> tuple[Any, jax.Array, dict[str, jax.Array]]:
        asked, away = flight
        landed = self.task.land(state.data, away)
        enforced = ~asked & self.task.irreversible(landed)
        following, drawn = jax.random.split(jax.random.wrap_key_data(state.info["key"]))
        changed = {**self._paid(state.info, asked, enforced), "key": jax.random.key_data(following)}
        fresh = self.task.with_goal(self.task.reset(drawn), state.info["goal"])
        moved = _chosen(asked | enforced, fresh, landed)
        info = _chosen(_ended(state.info), state.info, {**state.info, **changed})
        inner = _chosen(_ended(info), state.data, moved)
        return inner, self._vector(inner, info), info

    def _paid(self, info: dict[str, jax.Array], asked: jax.Array, enforced: jax.Array) -> dict[str, jax.Array]:
        """Return counts and budget after a step on which help was `asked` for or an intervention `enforced`, or neither.

        What is left is computed from the counts, so that a long life adds up no rounding.
        """
        counts = {"asked": info["asked"] + asked, "enforced": info["enforced"] + enforced}
        costs = {"asked": self.help_cost, "enforced": self.enforced_cost}
        paid = sum(counts[kind] * cost for kind, cost in costs.items())
        left = jnp.maximum(self.budget - paid, 0.0)
        return {**counts, "budget": jnp.where(left <= ROUNDING * self.budget, 0.0, left)}

    def _vector(self, inner: State, info: dict[str, jax.Array]) -> jax.Array:
        """Return the augmented state vector [s + 1]."""
        return jnp.append(inner.obs[: self.task.state_size], info["budget"] / self.budget)

    def _seen(self, inner: State, info: dict[str, jax.Array]) -> State:
        return self._state(inner, self._vector(inner, info), info)

    def _state(self, data: State, vector: jax.Array, info: dict[str, jax.Array]) -> State:
        state = super()._state(data, vector, info)
        return state.replace(reward=self.goal_reward(state, info["goal"]), done=_ended(info).astype(jnp.float32))

    def with_goal(self, state: State, goal: jax.Array) -> State:
        return super().with_goal(state.replace(data=self.task.with_goal(state.data, goal)), goal)

    def goal_reward(self, state: State, goal: jax.Array) -> jax.Array:
        return jnp.where(_ended(state.info), self.absorbed_reward, self.task.goal_reward(state.data, goal))

    def task_obs(self, obs: jax.Array) -> jax.Array:
        """Return what the task itself observes [..., s + g] of `obs [..., s + 1 + g]`: all but the budget."""
        return jnp.delete(obs, self.task.state_size, axis=-1, assume_unique_indices=True)

    def success(self, obs: jax.Array) -> jax.Array:
        return self.task.success(self.task_obs(obs)) & self._alive(obs)

    def reward(self, obs: jax.Array) -> jax.Array:
        return jnp.where(self._alive(obs), self.task.reward(self.task_obs(obs)), self.absorbed_reward)

    def _alive(self, obs: jax.Array) -> jax.Array:
        return obs[..., self.task.state_size] > 0

    def place(self, obs: jax.Array) -> jax.Array:
        return self.task.place(self.task_obs(obs))

    def expert(self, obs: jax.Array) -> jax.Array:
        """Return the action [a + 1] of the task's scripted controller, which never asks for help."""
        return jnp.append(self.task.expert(self.task_obs(obs)), -1.0)

    @property
    def has_demos(self) -> bool:
        return self.task.has_demos

    @property
    def demo_directions(self) -> tuple[str, ...]:
        return self.task.demo_directions

    def demos(self, direction: str) -> assets.Demos:
        """Return the task's demonstrations as of a life that has its whole budget and asks for nothing. Errors as the task's."""
        found = self.task.demos(direction)
        wider = {"states": 1.0, "next_states": 1.0, "actions": -1.0}
        parts = {
            name: np.pad(getattr(found, name), ((0, 0), (0, 1)), constant_values=value) for name, value in wider.items()
        }
        return found._replace(**parts)


def _ended(info: dict[str, jax.Array]) -> jax.Array:
    """Return whether a life has ended, bool []: its budget is 0 from then on and at no other time."""
    return info["budget"] <= 0


def _chosen(first: jax.Array, one: Any, other: Any) -> Any:
    """Return the tree `one` where `first`, else `other`."""
    return jax.tree.map(lambda a, b: jnp.where(first, a, b), one, other)
