"""The tasks as brax environments, for brax's wrappers and trainers and for other code that uses brax's Env.

Written for brax 0.14.2, whose own trainers fail on jax 0.10 and later (docs/adapters.md has the commands).
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
from brax.envs.base import Env as BraxEnv, State as BraxState
from brax.envs.wrappers import training

from earl_jax.adapters._session import Outputs, Session
from earl_jax.envs import Env, chosen_engine
from earl_jax.protocol import ProtocolState

NO_TIME_LIMIT = 2**30
"""More steps than any lifetime has; exact in float32, in which brax counts steps."""


def wrap_for_training(
    env: BraxEnv, episode_length: int, action_repeat: int = 1, randomization_fn: Any = None
) -> BraxEnv:
    """Return `env` wrapped as by brax's `training.wrap`, but without a time limit on a lifetime.

    This is the `wrap_env_fn` for brax's trainers.
    """
    is_lifetime = isinstance(env, ResetFreeEnv) and env.session.is_training
    return training.wrap(env, NO_TIME_LIMIT if is_lifetime else episode_length, action_repeat, randomization_fn)


class ResetFreeEnv(BraxEnv):
    """A task as one lifetime or as episodes, in the modes of `adapters.gymnasium.ResetFreeEnv`.

    `pipeline_state` holds the whole state, so brax's `AutoResetWrapper` always returns a lane to its very first state,
    with the same start, goal and randomness. brax's `EpisodeWrapper` and trainers accept raw keys
    (`jax.random.PRNGKey`) only; `reset` accepts typed keys as well.
    """

    def __init__(self, task: str | Env, **options: Any):
        """Make the environment of `task`, a name of `list_envs()` or an `Env`.

        `options` are `mode` (`train` for one lifetime, `eval` for episodes that brax's `EpisodeWrapper` ends),
        `setting`, `attempt_steps`, `starts`, and options of the task. `engine="auto"` uses the fastest for one lane.

        Raises:
            ValueError: a mode, setting, option or name is unknown; the message lists the choices.
        """
        self.session = Session.of(task, **options)

    def reset(self, rng: jax.Array) -> BraxState:
        """Return a state with s0 ~ rho and a task goal drawn uniformly, from a raw or a typed key `rng`."""
        typed = jnp.issubdtype(rng.dtype, jax.dtypes.prng_key)
        state, outputs = self.session.start_from_key(rng if typed else jax.random.wrap_key_data(rng))
        return BraxState(**self._fields(state, outputs, outputs.interventions))

    def step(self, state: BraxState, action: jax.Array) -> BraxState:
        """Return the state after one control step with `action [a]`; metrics are of this step, for brax to sum."""
        previous: Any = state.pipeline_state
        session_state, outputs = self.session.step(previous, action)
        fields = self._fields(session_state, outputs, previous.counters.interventions)
        fields["metrics"] = {**state.metrics, **fields["metrics"]}
        return dataclasses.replace(state, **fields)

    def set_goal(self, state: BraxState, goal: jax.Array | None = None) -> BraxState:
        """Return `state` with `goal [g]` or the environment's choice; for lanes, vmap `env.unwrapped.set_goal`."""
        previous: Any = state.pipeline_state
        session_state = self.session.set_goal(previous, goal, jnp.asarray(True))
        return dataclasses.replace(state, pipeline_state=session_state, obs=session_state.obs)

    def _fields(self, state: ProtocolState, outputs: Outputs, interventions_before: jax.Array) -> dict[str, Any]:
        """Return the fields of brax's state for a session in `state`; the metrics describe the last step alone."""
        done = outputs.terminated if self.session.is_training else outputs.terminated | outputs.fault
        metrics = {"success": outputs.success, "interventions": outputs.interventions - interventions_before}
        return {
            "pipeline_state": state,
            "obs": outputs.obs,
            "reward": outputs.reward,
            "done": done.astype(jnp.float32),
            "metrics": {name: value.astype(jnp.float32) for name, value in metrics.items()},
        }

    @property
    def observation_size(self) -> int:
        """Length s + g of `obs`."""
        return self.session.env.observation_size

    @property
    def action_size(self) -> int:
        """Length of an action."""
        return self.session.env.action_size

    @property
    def backend(self) -> str:
        """The physics engine's name, or `kinematic`."""
        return chosen_engine(self.session.env)
