"""The state of a session of the adapters, and what its steps and resets return."""

from typing import Any, NamedTuple

import jax
from flax import struct

from earl_jax.envs import State


class SessionState(struct.PyTreeNode):
    """The state of one lane.

    `key` of all future draws; `env_state`; int32 `steps` of the lifetime or the episode; int32 `attempt_age`: steps
    since the goal was drawn; int32 `interventions`; bool `goal_is_set`: the caller set the goal; bool `reached`: a step
    of the lifetime or the episode reached its goal.
    """

    key: jax.Array
    env_state: State
    steps: jax.Array
    attempt_age: jax.Array
    interventions: jax.Array
    goal_is_set: jax.Array
    reached: jax.Array


class StepResult(NamedTuple):
    """The result of a step or a reset: `obs [s + g]`, and scalars.

    `success`: the step reached the goal that it was made under. `reached`: so did a step of this episode. `terminated`:
    the lifetime ended. `truncated`: the episode is over. `fault`: the simulation broke, and the reward is 0.
    """

    obs: Any
    reward: Any
    success: Any
    reached: Any
    terminated: Any
    truncated: Any
    fault: Any
    interventions: Any
