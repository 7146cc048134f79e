"""What can be known of a task's transitions beyond one goal and one place: goals, translations, corrective actions."""

import dataclasses
from typing import NamedTuple

import jax

from earl_jax.envs import Env


class Correction(NamedTuple):
    """A transition from another state: `state, next_state [s]` and the `action [a]` that leads back.

    `approach []`: whether the action is right for every goal, because nothing has been grasped or pushed yet.
    """

    state: jax.Array
    action: jax.Array
    next_state: jax.Array
    approach: jax.Array


@dataclasses.dataclass(frozen=True)
class Knowledge:
    """Goals that later states of `env` met, and the other transitions that one transition tells about; here none."""

    env: Env

    def goal_from(self, state: jax.Array) -> jax.Array | None:
        """Return the goals [..., g] that ask for the object where it is in `state [..., s]`; None without an object.

        What is not the object is as in the task's first goal.
        """
        del state
        return None

    def translation(self, key: jax.Array, state: jax.Array, next_state: jax.Array) -> jax.Array | None:
        """Return a random vector [s] that can be added to `state [s]` and `next_state [s]` of a transition.

        The same action then leads from one sum to the other. It is 0 for a transition that something fixed takes part
        in, and where the sums would leave the space in which this holds. None: the task has no such symmetry.
        """
        del key, state, next_state
        return None

    def correction(
        self, key: jax.Array, state: jax.Array, action: jax.Array, next_state: jax.Array
    ) -> Correction | None:
        """Return a demonstrated transition with the robot away from `state [s]`, and the action that leads back to it.

        A transition that has no such neighbours is returned as it is. None: the task knows no corrections.
        """
        del key, state, action, next_state
        return None
