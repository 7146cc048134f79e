"""Evaluation without help: J_D belongs to the plain MDP, so requests, costs and restarts exist in training only.

Source: Sharma et al. 2022, appendix on irreversible states, footnote on A_h.
"""

import dataclasses
from typing import ClassVar

import jax

from earl_jax.envs.base import Env
from earl_jax.envs.state import NextState, State
from earl_jax.envs.wrappers.help_budget import HelpBudget


@dataclasses.dataclass(frozen=True)
class WithoutHelp(HelpBudget):
    """`task` in the spaces of a `HelpBudget`, for agents that need these: a full budget that nothing is charged to.

    The last action component has no effect, and an irreversible state or a fault stays as it is.
    """

    has_absorbing_state: ClassVar[bool] = False

    def fault(self, state: State) -> jax.Array:
        return self.task.fault(state.data)

    def _after(self, state: State, asked: jax.Array, moved: State) -> NextState:
        del asked
        return moved, self._vector(moved, state.info), {}


def without_budget(env: Env) -> Env:
    """Return the task in which policies are evaluated: that of `env` if it is a `HelpBudget`, else `env` itself."""
    return env.task if isinstance(env, HelpBudget) else env


def without_help(env: Env) -> Env:
    """Return `env` for evaluations with its own spaces: a `HelpBudget` as `WithoutHelp`, or `env` itself."""
    if not isinstance(env, HelpBudget):
        return env
    return WithoutHelp(**{field.name: getattr(env, field.name) for field in dataclasses.fields(env) if field.init})
