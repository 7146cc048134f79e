"""Behaviour cloning alone: what deployed success is worth without any learning from interaction."""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from flax import struct

from earl_jax.algos.fbrl import FBRL
from earl_jax.algos.learner.base import Batch, Learner
from earl_jax.algos.learner.sac import SAC
from earl_jax.algos.method import Moment
from earl_jax.envs import Env
from earl_jax.options.values import within


class BC(FBRL):
    """Clone the demonstrations, then live without learning.

    Clone the demonstrations before the first step, then live as FBRL does, without noise and without learning.

    On the demonstrated steps (s, g, a) of both directions, or of the one that the task has, `Learner.pretrain_steps`
    steps minimise `mean (pi(s, g) - a)^2` of the greedy policy pi. The agent then acts greedily: it neither explores
    nor learns, and the metrics of the learner are 0.

    Source: Pomerleau 1989 (ALVINN), the regression of actions on observations. No paper on EARL reports this method. It
    is the floor that a method with the same demonstrations has to beat. Phases and goals are those of `FBRL`. There are
    no random steps by default.
    """

    learner: Learner = SAC(random_steps=0, pretrain_steps=4000)
    controllers: int = struct.field(pytree_node=False, default=1, metadata=within("[1, 2]"))
    """1: one goal-conditioned actor; 2: one for each direction."""

    name: ClassVar[str] = "bc"

    def act(self, key: jax.Array, env: Env, actor: Any, obs: jax.Array, moment: Moment, method_state: Any) -> jax.Array:
        return self.learner.greedy(actor, obs)

    def learn(
        self, key: jax.Array, env: Env, agent: Any, batch: Batch, phase: jax.Array, method_state: Any
    ) -> tuple[Any, Any, dict[str, jax.Array]]:
        return agent, method_state, dict.fromkeys(self.learner.diagnostics, jnp.zeros(()))
