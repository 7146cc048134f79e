"""Irreversible states: a budget for interventions, an action that requests help, and an end when the budget is spent.

Source: Sharma et al. 2022, appendix A.2 (irreversible states). docs/formalism.md has the equations.
"""

import dataclasses
import functools
import operator
from collections.abc import Callable
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax import assets
from earl_jax.envs.base import Env
from earl_jax.envs.checks import require_result
from earl_jax.envs.demonstrations import TaskDemos
from earl_jax.envs.features import Map, Starts, View
from earl_jax.envs.state import State, stored_key, tree_where
from earl_jax.errors import InputError
from earl_jax.options.values import require_object, within
from earl_jax.physics import PendingStep

ROUNDING = 4 * float(np.finfo(np.float32).eps)
"""The largest share of a budget that float32 rounding can leave after it was spent exactly."""


def _of_task(name: str) -> Any:
    """Return a property that reads the attribute `name` of the wrapped task."""
    return property(operator.attrgetter(f"task.{name}"))


@dataclasses.dataclass(frozen=True)
class HelpBudget(Env):
    """`task` with a budget for help: `obs` = task state, share of the budget left, goal; `action` = task action, help.

    A last action component above `help_above` requests help. The body does not move, and the simulated step is
    discarded. The next state is s' ~ rho, and the budget (h_max at first) falls by `help_cost`. After a step into a
    state that is irreversible for the task, or after a fault, the environment enforces an intervention: s' ~ rho, for
    `enforced_cost`. The agent learns from the transitions of both interventions, and the goal does not change.

    An intervention that would exhaust the budget does not take place. The lifetime ends instead: `done` is 1, the
    budget is 0, the state stays as it was before that step, and every later step earns `absorbed_reward`. At the
    default threshold of 0.98, one in a hundred uniform actions requests help.
    """

    reward_type: str = dataclasses.field(init=False, repr=False)
    train_horizon: int = dataclasses.field(init=False, repr=False)
    eval_horizon: int = dataclasses.field(init=False, repr=False)
    demo_file: str | None = dataclasses.field(init=False, repr=False)
    task: Env
    budget: float = dataclasses.field(metadata=within("(0, 1000000000]"))
    help_cost: float = dataclasses.field(default=1.0, metadata=within("[0, 1000000000]"))
    enforced_cost: float = dataclasses.field(default=1.0, metadata=within("[0, 1000000000]"))
    help_above: float = dataclasses.field(default=0.98, metadata=within("[-1, 1)"))
    absorbed_reward: float = dataclasses.field(default=0.0, metadata=within("[-1000000000, 1000000000]"))

    has_absorbing_state: ClassVar[bool] = True

    def __post_init__(self):
        require_object("task", self.task, Env, or_name=False)
        if isinstance(self.task, HelpBudget):
            raise InputError(f"task must be a task without a budget of its own, not {self.task!r}")
        for field in dataclasses.fields(Env):
            object.__setattr__(self, field.name, getattr(self.task, field.name))
        super().__post_init__()
        if self.task.sparse and self.absorbed_reward:
            raise InputError(
                f"absorbed_reward must be 0 with a sparse reward, which is a success bit, not {self.absorbed_reward}"
            )

    name = _of_task("name")
    continuing = _of_task("continuing")
    goal_states = _of_task("goal_states")
    initial_states = _of_task("initial_states")
    sample_goal = _of_task("sample_goal")
    reward_scale = _of_task("reward_scale")

    @property
    def action_size(self) -> int:
        return self.task.action_size + 1

    @property
    def state_size(self) -> int:
        return self.task.state_size + 1

    @property
    def view(self) -> View | None:
        view = self.task.view
        return view and view._replace(
            render_state=lambda state: view.render_state(state.data),
            render_goal=lambda state: view.render_goal(state.data),
        )

    def reset(self, key: jax.Array) -> State:
        return self._reset_by(self.task.reset, key)

    @property
    def starts(self) -> Starts:
        starts = self.task.starts
        helped = {name: functools.partial(self._reset_by, start) for name, start in starts.functions.items()}
        return dataclasses.replace(starts, **helped)

    @property
    def object_position(self) -> Callable[[State], jax.Array] | None:
        position = self.task.object_position
        return position and (lambda state: position(state.data))

    @property
    def map(self) -> Map | None:
        task_map = self.task.map
        return task_map and task_map._replace(position=lambda obs: task_map.position(self.task_obs(obs)))

    def _reset_by(self, reset: Callable[..., State], key: jax.Array, *number: jax.Array) -> State:
        """Return the first state of a lifetime, with a full budget and the task's start `reset(key, *number)`.

        `info` counts the interventions that were `asked` for and `enforced`, including the one that ends the lifetime.
        `info["key"]` draws s' ~ rho.
        """
        inner_key, own_key = jax.random.split(key)
        inner, none = reset(inner_key, *number), jnp.zeros((), jnp.int32)
        info = {
            "goal": jnp.copy(inner.info["goal"]),
            "budget": jnp.asarray(self.budget, jnp.float32),
            "asked": none,
            "enforced": jnp.copy(none),
            "key": stored_key(own_key),
        }
        return self._augmented(inner, info)

    def intervene(self, key: jax.Array, state: State) -> State:
        """Return the state after a hard intervention: s0 ~ rho at no cost, with budget and counts unchanged.

        After the end of the lifetime, `state` is returned unchanged.
        """
        inner = self.task.intervene(key, state.data)
        fresh = self._augmented(inner, {**state.info, "goal": inner.info["goal"]})
        return tree_where(_ended(state.info), state, fresh)

    def fault(self, state: State) -> jax.Array:
        """Return False: this environment has already answered a fault of the task with an intervention."""
        return jnp.zeros((), bool)

    def start_step(self, state: State, action: jax.Array) -> PendingStep:
        action = self._checked_action(action)
        step = self.task.start_step(state.data, action[:-1])
        return PendingStep((action[-1] > self.help_above, step.payload), step.ticket)

    def finish_step(self, state: State, pending: PendingStep) -> State:
        asked, payload = pending.payload
        moved = self.task.finish_step(state.data, PendingStep(payload, pending.ticket))
        return self._augmented(*self._after(state, asked, moved))

    def _after(self, state: State, asked: jax.Array, moved: State) -> tuple[State, dict[str, jax.Array]]:
        """Return the task's state and `info` after a step to `moved`; `asked`, bool [], tells whether it requests help.

        The budget is computed from the counts, so rounding errors do not add up over a long lifetime.
        """
        irreversible = self.task.irreversible(moved)
        require_result(f"{self.task.name}: what irreversible returns", irreversible, (), "bool")
        enforced = ~asked & (irreversible | self.task.fault(moved))
        following, drawn = jax.random.split(jax.random.wrap_key_data(state.info["key"]))
        counts = {"asked": state.info["asked"] + asked, "enforced": state.info["enforced"] + enforced}
        paid = counts["asked"] * self.help_cost + counts["enforced"] * self.enforced_cost
        left = jnp.maximum(self.budget - paid, 0.0)
        budget = jnp.where(left <= ROUNDING * self.budget, 0.0, left)
        changed = {**counts, "budget": budget, "key": jax.random.key_data(following)}
        helped_from = tree_where(asked, state.data, moved)
        fresh = self.task.with_goal(self.task.intervene(drawn, helped_from), state.info["goal"])
        helped = tree_where(asked | enforced, fresh, moved)
        info = tree_where(_ended(state.info), state.info, {**state.info, **changed})
        return tree_where(_ended(info), state.data, helped), info

    def _augmented(self, inner: State, info: dict[str, jax.Array]) -> State:
        vector = jnp.append(inner.obs[: self.task.state_size], info["budget"] / self.budget)
        return self.make_state(inner, vector, info)

    def make_state(self, data: State, vector: jax.Array, info: dict[str, jax.Array]) -> State:
        return super().make_state(data, vector, info).replace(done=_ended(info).astype(jnp.float32))

    def with_goal(self, state: State, goal: jax.Array) -> State:
        return super().with_goal(state.replace(data=self.task.with_goal(state.data, goal)), goal)

    def goal_reward(self, state: State, goal: jax.Array) -> jax.Array:
        return jnp.where(_ended(state.info), self.absorbed_reward, self.task.goal_reward(state.data, goal))

    def task_obs(self, obs: jax.Array) -> jax.Array:
        """Return the task's observation [..., s + g]: `obs [..., s + 1 + g]` without the budget."""
        return jnp.delete(obs, self.task.state_size, axis=-1, assume_unique_indices=True)

    def success(self, obs: jax.Array) -> jax.Array:
        return self.task.success(self.task_obs(obs)) & self._budget_left(obs)

    def reward(self, obs: jax.Array) -> jax.Array:
        return jnp.where(self._budget_left(obs), self.task.reward(self.task_obs(obs)), self.absorbed_reward)

    def _budget_left(self, obs: jax.Array) -> jax.Array:
        return obs[..., self.task.state_size] > 0

    @property
    def demonstrations(self) -> TaskDemos:
        """The task's demonstrations with a full budget and without requests for help; there is no script."""
        demos = self.task.demonstrations
        expert = demos.expert
        return TaskDemos(
            demos.task,
            demos.file,
            (self.state_size, self.goal_size, self.action_size),
            layout=lambda recorded: _with_full_budget(demos.layout(recorded)),
            exchanged=demos.exchanged,
            expert=expert and (lambda obs: jnp.append(expert(self.task_obs(obs)), -1.0)),
        )


@dataclasses.dataclass(frozen=True)
class WithoutHelp(HelpBudget):
    """`task` in the spaces of a `HelpBudget`, for agents that expect these: the budget is full, and nothing is charged.

    The last action component has no effect, and nobody intervenes in an irreversible state or after a fault. J_D
    belongs to the plain MDP: requests, costs and restarts exist in training only (the footnote on A_h in the appendix).
    """

    has_absorbing_state: ClassVar[bool] = False

    def fault(self, state: State) -> jax.Array:
        return self.task.fault(state.data)

    def _after(self, state: State, asked: jax.Array, moved: State) -> tuple[State, dict[str, jax.Array]]:
        return moved, state.info


def without_budget(env: Env) -> Env:
    """Return the task in which policies are evaluated: `env.task` if `env` is a `HelpBudget`, else `env` itself."""
    return env.task if isinstance(env, HelpBudget) else env


def without_help(env: Env) -> Env:
    """Return `env` for evaluations in its own spaces: a `HelpBudget` becomes `WithoutHelp`, other tasks stay."""
    if not isinstance(env, HelpBudget):
        return env
    return WithoutHelp(**{field.name: getattr(env, field.name) for field in dataclasses.fields(env) if field.init})


def _with_full_budget(demos: assets.Demos) -> assets.Demos:
    """Return `demos` of a task in the spaces of a `HelpBudget`, with a full budget and no request for help."""
    wider = {"states": 1.0, "next_states": 1.0, "actions": -1.0}
    parts = {
        name: np.pad(getattr(demos, name), ((0, 0), (0, 1)), constant_values=value) for name, value in wider.items()
    }
    return demos._replace(**parts)


def _ended(info: dict[str, jax.Array]) -> jax.Array:
    """Return whether the lifetime has ended, bool []: only then is the budget 0."""
    return info["budget"] <= 0
