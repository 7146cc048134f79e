"""A learnt policy as a callable."""

from typing import Any

import jax
from flax import struct

from earl_jax.algos.learner import sac
from earl_jax.algos.learner.sac import SAC
from earl_jax.algos.method import TASK, Method
from earl_jax.envs import Env
from earl_jax.errors import InputError
from earl_jax.training.state import LaneState


class Policy(struct.PyTreeNode, eq=False):
    """The greedy task policy of one lane: `policy(obs [..., o]) -> action [..., a]`, pure, works under jit and vmap."""

    sac: SAC
    actor: Any
    obs_size: int = struct.field(pytree_node=False)
    action_size: int = struct.field(pytree_node=False)

    @classmethod
    def of(cls, env: Env, method: Method, lane: LaneState) -> "Policy":
        """Return the policy of one lane (no lane axis) of `method` on `env`."""
        actor = jax.tree.map(lambda leaf: leaf[TASK], lane.agent.actor)
        return cls(method.sac, actor, env.obs_size, env.action_size)

    def __call__(self, obs: jax.Array) -> jax.Array:
        """Return the greedy action [..., a] at `obs [..., o]`.

        Raises:
            ValueError: `obs` has another size.
        """
        if obs.shape[-1] != self.obs_size:
            raise InputError(f"obs has shape {obs.shape}, this policy takes (..., {self.obs_size})")
        return sac.greedy(self.sac, self.actor, obs, self.action_size)
