"""The base class of methods: a few pure functions that the training loop calls. The defaults are naive RL's."""

from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from earl_jax.algos.goals import GoalIndices, Goals
from earl_jax.algos.learner import sac as sac_lib
from earl_jax.algos.learner.cloning import Demonstrations, cloning_term, pretrained
from earl_jax.algos.learner.replay import TransitionBatch
from earl_jax.algos.learner.sac import SAC, Agent
from earl_jax.envs import Env
from earl_jax.errors import InputError

TASK, RETURN = 0, 1
"""The two phases: reach the task goal, then prepare the next attempt."""


class DemoList(NamedTuple):
    """A `direction` of demonstrations in the replay's list of a `controller`, in which each is `copies` times."""

    direction: str
    controller: int
    copies: int = 1


class Method(struct.PyTreeNode):
    """A reset-free learning method. Subclasses override parts of naive RL; float fields are vmappable leaves."""

    sac: SAC = SAC()

    name: ClassVar[str]
    controllers: ClassVar[int] = 1
    """Number of separate actor-critics, one for each phase, each with its own part of the replay."""
    phases: ClassVar[int] = 1
    critics: ClassVar[int] = sac_lib.SOFT_CRITICS
    """2, and 2 for each further pair of critics without entropy term, which follow `SAC.ensemble` in the stack."""
    resets: ClassVar[bool] = False
    """Whether the end of a phase also resets the environment; only the oracle does this."""
    needs_demos: ClassVar[bool] = False
    demo_directions: ClassVar[tuple[str, ...]] = ("forward",)
    """Directions of the demonstrations in the initial replay; with two controllers, the second samples the backward
    ones."""
    refresh_every: ClassVar[int] = 0
    """Steps between calls of `refresh`; 0 for never."""
    explore_hold: ClassVar[int] = 10
    """Steps for which a random action of `explores` is held."""
    later_steps: ClassVar[int] = 0
    """Mean number of steps to the states `later` that `relabel` receives; 0 for none."""
    own_rows: ClassVar[int] = 0
    """Transitions of the last controller's own, no demonstrations, that `refresh` receives; 0 for none."""

    def directions(self, env: Env) -> tuple[str, ...]:
        """Return the directions of the demonstrations in the initial replay on `env`, by default `demo_directions`."""
        del env
        return tuple(self.demo_directions)

    def demo_lists(self, env: Env) -> tuple[DemoList, ...]:
        """Return who samples which of the `directions` on `env`; by default controller i has the i-th, the last the rest."""
        return tuple(
            DemoList(direction, min(number, self.controllers - 1))
            for number, direction in enumerate(self.directions(env))
        )

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

    def explores(
        self, key: jax.Array, env: Env, phase: jax.Array, phase_step: jax.Array, method_state: Any
    ) -> jax.Array | bool:
        """Return whether this step's action is uniformly random instead of the policy's; never by default.

        `key` and the random action stay the same for `explore_hold` steps, so that the exploration gets somewhere.
        """
        del key, env, phase, phase_step, method_state
        return False

    def next_goal(
        self, key: jax.Array, goals: Goals, phase: jax.Array, current: GoalIndices, method_state: Any
    ) -> GoalIndices:
        """Return the goals of a new `phase`, by default a random task goal, which can equal the `current` one."""
        del phase, current, method_state
        task = goals.draw_task(key)
        return GoalIndices(goal=task, task=task)

    def relabel(
        self, key: jax.Array, env: Env, goals: Goals, batch: TransitionBatch, phase: jax.Array
    ) -> TransitionBatch:
        """Return the sampled transitions of one lane, `batch [B]`, with the goals to learn from.

        The controller that learns acted in `phase`. Rows that stay `demonstrated` are cloned with `SAC.cloning`.
        """
        del key, env, goals, phase
        return batch

    def reward(self, env: Env, goals: Goals, batch: TransitionBatch, phase: jax.Array, method_state: Any) -> jax.Array:
        """Return the rewards [B] of sampled transitions, by default the task's."""
        del env, goals, phase, method_state
        return batch.reward

    def terminal(self, batch: TransitionBatch, phase: jax.Array) -> jax.Array:
        """Return the transitions, bool [B], whose TD target does not bootstrap.

        These are successes, the end of a lifetime and, without `SAC.timeout_bootstrap`, time-outs.
        """
        del phase
        return (
            batch.flags.reached
            | batch.flags.absorbed
            | (batch.flags.timeout & ~jnp.asarray(self.sac.timeout_bootstrap, bool))
        )

    def init_state(self, key: jax.Array, env: Env, goals: Goals) -> Any:
        """Return the initial state of the method itself, a pytree of learnt or remembered values; empty by default."""
        del key, env, goals
        return ()

    def update_state(
        self, key: jax.Array, env: Env, goals: Goals, batch: TransitionBatch, phase: jax.Array, method_state: Any
    ) -> Any:
        """Return `method_state` after an update on the batch that the active controller has just learnt from."""
        del key, env, goals, batch, phase
        return method_state

    def own_metrics(self, method_state: Any) -> dict[str, jax.Array]:
        """Return scalars [] of the method itself by name, columns `METHOD/NAME` of metrics.csv; none by default."""
        del method_state
        return {}

    def pretrain(self, key: jax.Array, env: Env, agent: Agent, demos: Demonstrations | None) -> Agent:
        """Return `agent` (leading controller axis) before the first step, cloned in `SAC.pretrain_steps`.

        `demos` is None if there are none.

        Raises:
            ValueError: there are demonstrations to clone, and the task has none.
        """
        if not self.sac.pretrain_steps:
            return agent
        if demos is None:
            raise InputError(
                f"{self.name} needs demonstrations to clone, and {env.name} has none; use pretrain_steps=0"
            )
        return pretrained(key, self.sac, agent, demos)

    def update_agent(self, key: jax.Array, agent: Agent, batch: sac_lib.Batch) -> tuple[Agent, dict[str, jax.Array]]:
        """Return the acting controller after learning from `batch`, and `sac.DIAGNOSTICS`; by default a SAC update."""
        return sac_lib.update(self.sac, agent, batch, key, self.actor_term)

    def actor_term(self, parameters: jax.Array, batch: sac_lib.Batch) -> jax.Array | None:
        """Return a term [] to add to the actor's loss, or None; by default `cloning_term`.

        `parameters [B, 2a]` are those of the policy at `batch.obs`: means before the tanh, then log standard deviations
        before clipping. They are differentiated.
        """
        return cloning_term(self.sac, parameters, batch)

    def refresh(
        self, key: jax.Array, env: Env, goals: Goals, agent: Agent, method_state: Any, own: TransitionBatch | None
    ) -> Any:
        """Return `method_state` refreshed with `agent` (leading controller axis), every `refresh_every` steps.

        `own [own_rows]` are transitions of the last controller's own, `demonstrated` where it has none yet; None if
        `own_rows` is 0.
        """
        del key, env, goals, agent, own
        return method_state
