"""A learnt policy as a callable."""

from typing import Any

import jax
from flax import struct

from earl_jax.algos.learner import networks, sac
from earl_jax.algos.learner.sac import SAC
from earl_jax.algos.method import TASK, Method
from earl_jax.envs import Env, plain_task
from earl_jax.errors import InputError
from earl_jax.training.state import LaneState

FULL_BUDGET = 1.0
"""The share of the budget for help at which a policy is evaluated, where nothing is charged."""


def plain_actor(env: Env, actor: Any) -> Any:
    """Return the task actor of `env` for `plain_task(env)`: it observes a full budget and has no component for help.

    `actor` has any leading axes. Without a budget, it is returned as it is.
    """
    plain = plain_task(env)
    if plain is env:
        return actor
    return networks.drop_action(networks.fix_input(actor, plain.state_size, FULL_BUDGET), plain.action_size)


class Policy(struct.PyTreeNode, eq=False):
    """The greedy task policy of one lane: `policy(obs [..., o]) -> action [..., a]`, pure, works under jit and vmap.

    Sizes are those of the plain task, also after training with a budget for help (`plain_actor`).
    """

    sac: SAC
    actor: Any
    obs_size: int = struct.field(pytree_node=False)
    action_size: int = struct.field(pytree_node=False)

    @classmethod
    def of(cls, env: Env, method: Method, lane: LaneState) -> "Policy":
        """Return the policy of one lane (no lane axis) of `method` on `env`."""
        actor = plain_actor(env, jax.tree.map(lambda leaf: leaf[TASK], lane.agent.deployed_actor))
        plain = plain_task(env)
        return cls(method.sac, actor, plain.obs_size, plain.action_size)

    def __call__(self, obs: jax.Array) -> jax.Array:
        """Return the greedy action [..., a] at `obs [..., o]`.

        Raises:
            ValueError: `obs` has another size.
        """
        if obs.shape[-1] != self.obs_size:
            raise InputError(f"obs has shape {obs.shape}, this policy takes (..., {self.obs_size})")
        return sac.greedy(self.sac, self.actor, obs, self.action_size)
