"""Behaviour cloning alone: what deployed success is worth without any learning from interaction."""

from typing import ClassVar

import jax
from flax import struct

from earl_jax.algos.fbrl import FBRL
from earl_jax.algos.learner import networks
from earl_jax.algos.learner import sac as sac_lib
from earl_jax.algos.learner.sac import SAC, Agent
from earl_jax.envs import Env
from earl_jax.options.values import within


class BC(FBRL):
    """Clone the demonstrations before the first step, then live as FBRL does, without noise and without learning.

    With the demonstrated steps (s, g, a) of both directions, or of those that the task has, the policy
    pi = tanh N(mu(s, g), e^(2 l)) minimises `mean (tanh mu(s, g) - a)^2` in `SAC.pretrain_steps`. Then l = -20,
    so that the actor takes its mode: nothing explores. No update follows, and critics and temperature stay at their
    initial values; the metrics of the learner are 0.

    Source: Pomerleau 1989 (ALVINN), the regression of actions on observations. No paper on EARL has this row: it is the
    floor that a method with the same demonstrations has to beat. Phases and goals are those of `FBRL`. There are no
    random steps by default.
    """

    sac: SAC = SAC(random_steps=0, pretrain_steps=4000, pretrain_log_std=networks.LOG_STD_RANGE[0])
    controllers: int = struct.field(pytree_node=False, default=1, metadata=within("[1, 2]"))
    """1: one goal-conditioned actor; 2: one for each direction."""

    name: ClassVar[str] = "bc"

    def directions(self, env: Env) -> tuple[str, ...]:
        return tuple(direction for direction in self.demo_directions if direction in env.demo_directions)

    def update_agent(self, key: jax.Array, agent: Agent, batch: sac_lib.Batch) -> tuple[Agent, dict[str, jax.Array]]:
        return sac_lib.without_update(agent)
