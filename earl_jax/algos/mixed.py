"""Several methods in one program: lanes of the same shapes that answer the loop's questions differently."""

from collections.abc import Callable, Hashable, Sequence
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.algos.goals import GoalIndices, Goals
from earl_jax.algos.learner.replay import TransitionBatch
from earl_jax.algos.method import Method
from earl_jax.envs import Env


class Mixed(Method):
    """Lanes of several methods: all `members` answer every question, and a lane keeps the answer of its own `member`.

    Members agree in their `program_signature`; what that fixes is asked of the first one.
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
    def resets(self) -> jax.Array:
        return self._own(lambda member: member.resets)

    def _own(self, ask: Callable[[Method], Any]) -> Any:
        answer = ask(self.members[0])
        for number, other in enumerate(self.members[1:], 1):
            mine = self.member == number
            answer = jax.tree.map(lambda new, old, mine=mine: jnp.where(mine, new, old), ask(other), answer)
        return answer

    def demo_copies(self, steps_left: np.ndarray) -> np.ndarray:
        return self.members[0].demo_copies(steps_left)

    def phase_length(self, env: Env, phase: jax.Array) -> jax.Array:
        return self._own(lambda member: member.phase_length(env, phase))

    def ends_on_success(self, phase: jax.Array) -> jax.Array:
        return self._own(lambda member: member.ends_on_success(phase))

    def next_goal(
        self, key: jax.Array, goals: Goals, phase: jax.Array, current: GoalIndices, method_state: Any
    ) -> GoalIndices:
        return self._own(lambda member: member.next_goal(key, goals, phase, current, method_state))

    def relabel(self, key: jax.Array, env: Env, goals: Goals, batch: TransitionBatch) -> TransitionBatch:
        return self._own(lambda member: member.relabel(key, env, goals, batch))

    def reward(self, batch: TransitionBatch, phase: jax.Array, method_state: Any) -> jax.Array:
        return self._own(lambda member: member.reward(batch, phase, method_state))

    def terminal(self, batch: TransitionBatch) -> jax.Array:
        return self._own(lambda member: member.terminal(batch))


def program_signature(method: Method) -> Hashable:
    """Return what methods have to agree in to share one program.

    Float hyper-parameters are free. A method that learns or remembers something of its own shares with its class alone.
    """
    kind = type(method)
    if any(getattr(kind, part) is not getattr(Method, part) for part in ("init_state", "update_state", "refresh")):
        return _kind(method)
    shapes = (method.controllers, method.phases, method.critics, method.needs_demos, tuple(method.demo_directions))
    return jax.tree.structure(method.sac), shapes, kind.demo_copies


def together(methods: Sequence[Method]) -> Method:
    """Return one method for the lanes of all `methods`, whose leaves have a leading lane axis, in their order.

    Raises:
        ValueError: the methods differ in what one program fixes.
    """
    if len({program_signature(method) for method in methods}) > 1:
        names = ", ".join(sorted({method.name for method in methods}))
        raise ValueError(f"these methods can't share a program, their shapes differ: {names}")
    kinds = list(dict.fromkeys(_kind(method) for method in methods))
    which = [kinds.index(_kind(method)) for method in methods]
    if len(kinds) == 1:
        return _joined(methods)
    members = []
    for number in range(len(kinds)):
        example = methods[which.index(number)]
        parts = [
            method if own == number else _like(example, method) for method, own in zip(methods, which, strict=True)
        ]
        members.append(_joined(parts))
    sizes = [_lanes(method) for method in methods]
    return Mixed(members[0].sac, tuple(members), jnp.repeat(jnp.asarray(which), jnp.asarray(sizes)))


def _kind(method: Method) -> Hashable:
    # Tree structures of two classes compare equal where their static fields do.
    return type(method), jax.tree.structure(method)


def _joined(methods: Sequence[Method]) -> Method:
    return jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *methods)


def _lanes(method: Method) -> int:
    return jax.tree.leaves(method)[0].shape[0]


def _like(example: Method, method: Method) -> Method:
    """Return a method of the kind of `example` for the lanes of `method`, where its answers go unused."""
    lanes = _lanes(method)
    return jax.tree.map(lambda leaf: jnp.broadcast_to(leaf[:1], (lanes,)), example).replace(sac=method.sac)
