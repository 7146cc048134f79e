"""The base class of methods: a few pure functions that the training loop calls. The defaults are naive RL's."""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from earl_jax.algos.goals import GoalIndices, Goals
from earl_jax.algos.learner import sac as sac_lib
from earl_jax.algos.learner.cloning import Demonstrations
from earl_jax.algos.learner.replay import TransitionBatch
from earl_jax.algos.learner.sac import SAC, Agent
from earl_jax.envs import Env

TASK, RETURN = 0, 1
"""The two phases: reach the task goal, then prepare the next attempt."""
RENAMED_HOOKS = {"init_extra": "init_state", "learn_extra": "update_state"}
"""Former and current names of hooks; a subclass that defines a former one is refused."""


class Method(struct.PyTreeNode):
    """A reset-free learning method. Subclasses override parts of naive RL; float fields are vmappable leaves."""

    sac: SAC = SAC()

    name: ClassVar[str]
    controllers: ClassVar[int] = 1
    """Number of separate actor-critics, one for each phase, each with its own part of the replay."""
    phases: ClassVar[int] = 1
    critics: ClassVar[int] = sac_lib.SOFT_CRITICS
    resets: ClassVar[bool] = False
    """Whether the end of a phase also resets the environment; only the oracle does this."""
    needs_demos: ClassVar[bool] = False
    demo_directions: ClassVar[tuple[str, ...]] = ("forward",)
    """Directions of the demonstrations in the initial replay; with two controllers, the second samples the backward
    ones."""
    refresh_every: ClassVar[int] = 0
    """Steps between calls of `refresh`; 0 for never."""

    def __init_subclass__(cls, **options: Any):
        super().__init_subclass__(**options)
        for name in RENAMED_HOOKS.keys() & vars(cls).keys():
            raise TypeError(f"{cls.__name__}.{name} is called {RENAMED_HOOKS[name]} now; rename it")

    def directions(self, env: Env) -> tuple[str, ...]:
        """Return the directions of the demonstrations in the initial replay on `env`, by default `demo_directions`."""
        del env
        return tuple(self.demo_directions)

    def demo_copies(self, steps_left: np.ndarray) -> np.ndarray:
        """Return the number of times [T] that the replay lists each demonstrated transition.

        `steps_left [T]` are the steps to the end of its demonstration.
        """
        return np.ones_like(steps_left)

    def phase_length(self, env: Env, phase: jax.Array) -> jax.Array | int:
        """Return the number of steps after which `phase` times out, H_E by default."""
        del phase
        return env.eval_horizon

    def phase_age(self, step: jax.Array, phase_step: jax.Array) -> jax.Array:
        """Return the steps that count towards `phase_length` before step `step`, counted from 0; by default `phase_step`.

        `phase_step` are the steps since the phase began.
        """
        del step
        return phase_step

    def ends_on_success(self, phase: jax.Array) -> jax.Array | bool:
        """Return whether reaching the goal ends `phase` (sparse tasks only)."""
        del phase
        return True

    def switches(
        self,
        key: jax.Array,
        env: Env,
        agent: Agent,
        obs: jax.Array,
        phase: jax.Array,
        phase_step: jax.Array,
        method_state: Any,
    ) -> jax.Array | bool:
        """Return whether the method itself ends `phase` after this step, as a time-out; never by default.

        `obs [o]` is the observation before the step, `agent` the controller that acted, without a leading axis.
        """
        del key, env, agent, obs, phase, phase_step, method_state
        return False

    def next_goal(
        self, key: jax.Array, goals: Goals, phase: jax.Array, current: GoalIndices, method_state: Any
    ) -> GoalIndices:
        """Return the goals of a new `phase`, by default a random task goal, which can equal the `current` one."""
        del phase, current, method_state
        task = goals.draw_task(key)
        return GoalIndices(goal=task, task=task)

    def relabel(self, key: jax.Array, env: Env, goals: Goals, batch: TransitionBatch) -> TransitionBatch:
        """Return the sampled transitions of one lane, `batch [B]`, with the goals to learn from."""
        del key, env, goals
        return batch

    def reward(self, batch: TransitionBatch, phase: jax.Array, method_state: Any) -> jax.Array:
        """Return the rewards [B] of sampled transitions, by default the task's."""
        del phase, method_state
        return batch.reward

    def terminal(self, batch: TransitionBatch) -> jax.Array:
        """Return the transitions, bool [B], whose TD target does not bootstrap.

        These are successes, the end of a lifetime and, without `SAC.timeout_bootstrap`, time-outs.
        """
        return (
            batch.flags.reached
            | batch.flags.absorbed
            | (batch.flags.timeout & ~jnp.asarray(self.sac.timeout_bootstrap, bool))
        )

    def init_state(self, key: jax.Array, env: Env, goals: Goals) -> Any:
        """Return the initial state of the method itself, a pytree of learnt or remembered values; empty by default."""
        del key, env, goals
        return ()

    def update_state(self, method_state: Any, batch: TransitionBatch, phase: jax.Array) -> Any:
        """Return `method_state` after an update on the batch that the active controller has just learnt from."""
        del batch, phase
        return method_state

    def pretrain(self, key: jax.Array, env: Env, agent: Agent, demos: Demonstrations | None) -> Agent:
        """Return `agent` (leading controller axis) before the first step; `demos` is None if there are none."""
        del key, env, demos
        return agent

    def update_agent(self, key: jax.Array, agent: Agent, batch: sac_lib.Batch) -> tuple[Agent, dict[str, jax.Array]]:
        """Return the acting controller after learning from `batch`, and `sac.DIAGNOSTICS`; by default a SAC update."""
        return sac_lib.update(self.sac, agent, batch, key)

    def refresh(self, key: jax.Array, env: Env, goals: Goals, agent: Agent, method_state: Any) -> Any:
        """Return `method_state` refreshed with `agent` (leading controller axis), every `refresh_every` steps."""
        del key, env, goals, agent
        return method_state


def __getattr__(name: str) -> Any:
    if name == "Commands":  # the earlier name of GoalIndices
        return GoalIndices
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
