"""What is known of each task: `KNOWN`, a table from classes of tasks to classes of knowledge."""

import dataclasses

import jax
import jax.numpy as jnp

from earl_jax.envs import Env
from earl_jax.envs.sawyer.door import SawyerDoor
from earl_jax.envs.sawyer.peg import SawyerPeg
from earl_jax.envs.tabletop import LIMIT, TabletopOrganization
from earl_jax_cfbrl import peg
from earl_jax_cfbrl.knowledge import Correction, Knowledge


@dataclasses.dataclass(frozen=True)
class Tabletop(Knowledge):
    """A mug that the gripper can carry anywhere between the walls."""

    env: TabletopOrganization

    def goal_from(self, state: jax.Array) -> jax.Array | None:
        """Return None unless success counts the mug alone: else a later state meets a goal that asks for a gripper at home
        too, at the end of a phase only."""
        if not (self.env.wide or self.env.mug_only):
            return None
        goal = jnp.asarray(self.env.goal_states[0])
        return jnp.broadcast_to(goal, state.shape).at[..., 2:4].set(state[..., 2:4])

    def translation(self, key: jax.Array, state: jax.Array, next_state: jax.Array) -> jax.Array:
        """Return a vector [6] that moves gripper and mug alike, where neither touches a wall before or after."""
        offset = jax.random.uniform(key, (2,), minval=-LIMIT, maxval=LIMIT) - state[2:4]
        positions = jnp.stack([state[:4], next_state[:4]]).reshape(4, 2)
        inside = (jnp.abs(jnp.stack([positions, positions + offset])) < LIMIT).all()
        return jnp.where(inside, jnp.concatenate([offset, offset, jnp.zeros(2)]), 0.0)


@dataclasses.dataclass(frozen=True)
class Door(Knowledge):
    """A handle whose place is the end of a state and of a goal."""

    def goal_from(self, state: jax.Array) -> jax.Array:
        """Return the first goal [..., g] with the object where it is in `state [..., s]`."""
        goal = jnp.broadcast_to(jnp.asarray(self.env.goal_states[0]), state.shape)
        return goal.at[..., -3:].set(state[..., -3:])


@dataclasses.dataclass(frozen=True)
class Peg(Door):
    """A peg that the hand can carry across the table, and a scripted way for hand and peg back to the demonstrated one."""

    env: SawyerPeg

    def translation(self, key: jax.Array, state: jax.Array, next_state: jax.Array) -> jax.Array | None:
        """Return a vector [7] that moves hand and peg alike across the table; None without the gripper in the state."""
        return peg.translation(key, state, next_state) if self.env.variant == "released" else None

    def correction(
        self, key: jax.Array, state: jax.Array, action: jax.Array, next_state: jax.Array
    ) -> Correction | None:
        """Return a transition with the hand, the carried peg or the inserted peg elsewhere; None as `translation`."""
        return peg.correction(key, state, action, next_state) if self.env.variant == "released" else None


KNOWN: dict[type[Env], type[Knowledge]] = {TabletopOrganization: Tabletop, SawyerDoor: Door, SawyerPeg: Peg}


def knowledge_of(env: Env) -> Knowledge:
    """Return what is known of `env`, by its class or the nearest base class in `KNOWN`; of other tasks nothing is."""
    return next((KNOWN[cls] for cls in type(env).__mro__ if cls in KNOWN), Knowledge)(env)
