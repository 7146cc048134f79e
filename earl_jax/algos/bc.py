"""Behaviour cloning alone: what deployed success is worth without any learning from interaction."""

from typing import ClassVar

import jax
import jax.numpy as jnp
from flax import struct

from earl_jax.algos.fbrl import FBRL
from earl_jax.algos.learner import networks
from earl_jax.algos.learner import sac as sac_lib
from earl_jax.algos.learner.cloning import Demonstrations, clone
from earl_jax.algos.learner.sac import SAC, Agent
from earl_jax.envs import Env
from earl_jax.errors import InputError
from earl_jax.options import COUNT, within


class BC(FBRL):
    """Clone the demonstrations before the first step, then live as FBRL does, without noise and without learning.

    With the demonstrated steps (s, g, a) of both directions, or of those that the task has, the policy
    pi = tanh N(mu(s, g), e^(2 l)) minimises `mean (tanh mu(s, g) - a)^2` in `pretrain_steps` Adam steps. Then l = -20,
    so that the actor takes its mode: nothing explores. No update follows, and critics and temperature stay at their
    initial values; the metrics of the learner are 0.

    Source: Pomerleau 1989 (ALVINN), the regression of actions on observations. No paper on EARL has this row: it is the
    floor that a method with the same demonstrations has to beat. Phases and goals are those of `FBRL`. There are no
    random steps by default.
    """

    sac: SAC = SAC(random_steps=0)
    controllers: int = struct.field(pytree_node=False, default=1, metadata=within("[1, 2]"))
    """1: one goal-conditioned actor; 2: one for each direction."""
    pretrain_steps: int = struct.field(pytree_node=False, default=4000, metadata=within(COUNT))
    """Cloning steps, each on a batch of `SAC.batch_size` demonstrated steps."""
    pretrain_rate: float = struct.field(default=1e-3, metadata=within("(0, 1]"))
    """Adam's step size while cloning."""

    name: ClassVar[str] = "bc"

    def directions(self, env: Env) -> tuple[str, ...]:
        return tuple(direction for direction in self.demo_directions if direction in env.demo_directions)

    def pretrain(self, key: jax.Array, env: Env, agent: Agent, demos: Demonstrations | None) -> Agent:
        """Return `agent` with cloned actors.

        Raises:
            ValueError: the task has no demonstrations.
        """
        if demos is None:
            raise InputError(f"{self.name} needs demonstrations, and {env.name} has none")
        actor, _ = clone(key, self.sac, agent.actor, demos, self.pretrain_steps, self.pretrain_rate)
        return agent.replace(actor=networks.fix_log_std(actor, networks.LOG_STD_RANGE[0]))

    def update_agent(self, key: jax.Array, agent: Agent, batch: sac_lib.Batch) -> tuple[Agent, dict[str, jax.Array]]:
        return agent, dict.fromkeys(sac_lib.DIAGNOSTICS, jnp.zeros(()))
