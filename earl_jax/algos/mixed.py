"""Several methods in one program: their lanes have the same shapes and differ in the hooks of `Method`."""

from collections.abc import Callable, Hashable, Sequence
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.algos.goals import GoalIndices, Goals
from earl_jax.algos.learner.replay import TransitionBatch
from earl_jax.algos.learner.sac import Agent
from earl_jax.algos.method import DemoList, Method
from earl_jax.envs import Env
from earl_jax.errors import InputError

UNSHARED_HOOKS = (
    *("init_state", "update_state", "refresh", "own_metrics"),
    *("pretrain", "update_agent", "actor_term", "directions", "demo_lists"),
)
"""Hooks of a `method_state`, a learner or demonstrations of a method's own."""


class MixedMethod(Method):
    """Lanes of several methods: every hook calls all `members`, and each lane uses the result of its own `member`.

    `member [N]` is the index of each lane's method in `members`. The members have the same `program_signature`, so the
    properties that it covers are those of the first one.
    """

    members: tuple[Method, ...] = ()
    member: Any = 0

    name: ClassVar[str] = "mixed"

    @property
    def controllers(self) -> int:
        return self.members[0].controllers

    @property
    def phases(self) -> int:
        return self.members[0].phases

    @property
    def critics(self) -> int:
        return self.members[0].critics

    @property
    def needs_demos(self) -> bool:
        return self.members[0].needs_demos

    @property
    def demo_directions(self) -> tuple[str, ...]:
        return self.members[0].demo_directions

    @property
    def explore_hold(self) -> int:
        return self.members[0].explore_hold

    @property
    def later_steps(self) -> int:
        return self.members[0].later_steps

    @property
    def resets(self) -> jax.Array:
        return self._select(lambda member: member.resets)

    def _select(self, hook: Callable[[Method], Any]) -> Any:
        """Return the result of `hook` on this lane's own member."""
        result = hook(self.members[0])
        for number, other in enumerate(self.members[1:], 1):
            own = self.member == number
            result = jax.tree.map(lambda new, old, own=own: jnp.where(own, new, old), hook(other), result)
        return result

    def directions(self, env: Env) -> tuple[str, ...]:
        return self.members[0].directions(env)

    def demo_lists(self, env: Env) -> tuple[DemoList, ...]:
        return self.members[0].demo_lists(env)

    def demo_copies(self, steps_left: np.ndarray) -> np.ndarray:
        return self.members[0].demo_copies(steps_left)

    def phase_length(self, env: Env, phase: jax.Array) -> jax.Array:
        return self._select(lambda member: member.phase_length(env, phase))

    def phase_age(self, step: jax.Array, phase_step: jax.Array) -> jax.Array:
        return self._select(lambda member: member.phase_age(step, phase_step))

    def ends_on_success(self, phase: jax.Array) -> jax.Array:
        return self._select(lambda member: member.ends_on_success(phase))

    def switches(
        self,
        key: jax.Array,
        env: Env,
        agent: Agent,
        obs: jax.Array,
        phase: jax.Array,
        phase_step: jax.Array,
        method_state: Any,
    ) -> jax.Array:
        return self._select(lambda member: member.switches(key, env, agent, obs, phase, phase_step, method_state))

    def explores(
        self, key: jax.Array, env: Env, phase: jax.Array, phase_step: jax.Array, method_state: Any
    ) -> jax.Array | bool:
        if all(type(member).explores is Method.explores for member in self.members):
            return False
        return self._select(lambda member: member.explores(key, env, phase, phase_step, method_state))

    def next_goal(
        self, key: jax.Array, goals: Goals, phase: jax.Array, current: GoalIndices, method_state: Any
    ) -> GoalIndices:
        return self._select(lambda member: member.next_goal(key, goals, phase, current, method_state))

    def relabel(
        self, key: jax.Array, env: Env, goals: Goals, batch: TransitionBatch, phase: jax.Array
    ) -> TransitionBatch:
        return self._select(lambda member: member.relabel(key, env, goals, batch, phase))

    def reward(self, env: Env, goals: Goals, batch: TransitionBatch, phase: jax.Array, method_state: Any) -> jax.Array:
        return self._select(lambda member: member.reward(env, goals, batch, phase, method_state))

    def terminal(self, batch: TransitionBatch, phase: jax.Array) -> jax.Array:
        return self._select(lambda member: member.terminal(batch, phase))


def program_signature(method: Method) -> Hashable:
    """Return the properties of `method` that all methods of one program must share.

    Float hyper-parameters may differ. A method that defines one of `UNSHARED_HOOKS` can share a program with its own
    class only.
    """
    method_class = type(method)
    if any(getattr(method_class, hook) is not getattr(Method, hook) for hook in UNSHARED_HOOKS):
        return _structure(method)
    shapes = (method.controllers, method.phases, method.critics, method.needs_demos, tuple(method.demo_directions))
    steps = (method.explore_hold, method.later_steps)
    return jax.tree.structure(method.sac), shapes, steps, method_class.demo_copies


def mix_methods(methods: Sequence[Method]) -> Method:
    """Return one method for the lanes of all `methods`, in their order; every leaf has a leading lane axis.

    Raises:
        ValueError: the methods have different program signatures.
    """
    if len({program_signature(method) for method in methods}) > 1:
        names = ", ".join(sorted({method.name for method in methods}))
        raise InputError(f"these methods can't share a program, their shapes differ: {names}")
    structures = list(dict.fromkeys(_structure(method) for method in methods))
    indices = [structures.index(_structure(method)) for method in methods]
    if len(structures) == 1:
        return _concatenate(methods)
    members = []
    for number in range(len(structures)):
        example = methods[indices.index(number)]
        parts = [
            method if index == number else _placeholder(example, method)
            for method, index in zip(methods, indices, strict=True)
        ]
        members.append(_concatenate(parts))
    sizes = [_lane_count(method) for method in methods]
    member = jnp.repeat(jnp.asarray(indices), jnp.asarray(sizes))
    return MixedMethod(members[0].sac, tuple(members), member)


def _structure(method: Method) -> Hashable:
    """Return the class and tree structure of `method`; the structures of two classes can be equal."""
    return type(method), jax.tree.structure(method)


def _concatenate(methods: Sequence[Method]) -> Method:
    """Return `methods` of one structure as one method, joined along the lane axis."""
    return jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *methods)


def _lane_count(method: Method) -> int:
    return jax.tree.leaves(method)[0].shape[0]


def _placeholder(example: Method, method: Method) -> Method:
    """Return a method of the class of `example` for the lanes of `method`, which never use its results."""
    lanes = _lane_count(method)
    return jax.tree.map(lambda leaf: jnp.broadcast_to(leaf[:1], (lanes,)), example).replace(sac=method.sac)
