"""RISC: forward and backward phases of one agent, which leaves a phase early when it is confident of success."""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from flax import struct

from earl_jax.algos.fbrl import FBRL
from earl_jax.algos.learner.base import Learner
from earl_jax.algos.learner.sac import SAC
from earl_jax.algos.method import Moment, controller_of, select_controller
from earl_jax.envs import Env
from earl_jax.errors import InputError
from earl_jax.options.values import within


class RISC(FBRL):
    """As FBRL, with early switches where success is likely.

    Alternate phases as FBRL does with one goal-conditioned agent, and switch early where success is likely.

    Success critics P1, P2 learn the discounted probability of success, `P(s, g, a) <- t + (1 - t) gamma min P'(s', g,
    a')` with t = 1 where s' reaches g. Step number c of a phase, counted from 1, ends it with probability
    `share p (1 - k^c)` if c is at least a share of H_E, where p is the mean of `min(P1, P2)(s, g, a)` over sampled
    actions. Such an end is a time-out, and the target bootstraps through time-outs.

    Source: Patil et al. 2024, "Intelligent Switching for Reset-Free RL" (RISC), and its released code. Deliberate
    differences: P is the entropy-free critic pair over the reward scale, clipped to [0, 1], with a linear output and
    networks of its own, instead of heads `(1 - cos z) / 2` on the critics' trunk, and it learns from the reward; with
    `timeout_bootstrap=False` (the value in the released configurations), P stops at time-outs too. The switch is
    decided with the agent after the step's update instead of before it. Networks, temperature's loss and the clipping
    of log-std to [-20, 2] (release: [-20, 10]) are this package's `SAC`. As in the released code, `switch_share`
    multiplies the probability at every step; the text instead exempts whole phases. On dense tasks no phase ends early,
    because the critics estimate returns.
    """

    learner: Learner = SAC(timeout_bootstrap=True, random_steps=10_000)
    controllers: int = struct.field(pytree_node=False, default=1, metadata=within("[1, 2]"))
    """1: one agent with the demonstrations of both directions, as released; 2: one agent for each direction."""
    switching: bool = struct.field(pytree_node=False, default=True)
    """Whether phases can end early; False is the paper's ablation, which has no success critics."""
    conservative_factor: float = struct.field(default=0.9, metadata=within("[0, 1]", switching=False))
    """k in `1 - k^c`, the factor on the probability at step c of a phase (released; Minitaur: 0.95)."""
    earliest_switch: float = struct.field(default=0.5, metadata=within("[0, 1]", switching=False))
    """Share of H_E before which no phase ends early (released: tabletop and peg 0.5, door 0.75, Minitaur 0.25)."""
    switch_share: float = struct.field(default=1.0, metadata=within("[0, 1]", switching=False))
    """Factor on the probability of an early end (released: tabletop and door 1, peg 0.5, Minitaur 0.25)."""
    value_samples: int = struct.field(pytree_node=False, default=5, metadata=within("[1, 1024]", switching=False))
    """Number of sampled actions over which p is averaged (released)."""

    name: ClassVar[str] = "risc"

    def __post_init__(self):
        if self.switching and self.fixed_phases:
            raise InputError("fixed_phases excludes switches, which end phases early; add switching=false")

    @property
    def entropy_free_pairs(self) -> int:
        return int(self.switching)

    def ends_phase(
        self, key: jax.Array, env: Env, agent: Any, obs: jax.Array, moment: Moment, method_state: Any
    ) -> jax.Array:
        """Return whether the phase has lasted H_E steps, or the agent leaves it early."""
        expired = super().ends_phase(key, env, agent, obs, moment, method_state)
        if not (self.switching and env.sparse):
            return expired
        value_key, draw_key = jax.random.split(key)
        count = moment.phase_step + 1
        acting = select_controller(agent, controller_of(self, moment.phase))
        chance = self.success_chance(value_key, acting, obs) * (1 - self.conservative_factor**count)
        late = count >= self.earliest_switch * env.eval_horizon * (1 - 1e-6)  # 0.3 * 200 is above 60 in float32
        return expired | (late & (jax.random.uniform(draw_key) < self.switch_share * chance))

    def success_chance(self, key: jax.Array, agent: Any, obs: jax.Array) -> jax.Array:
        """Return p [], the discounted probability with which `agent` reaches the goal in `obs [o]`."""
        repeated = jnp.broadcast_to(obs, (self.value_samples, len(obs)))
        values = self.learner.value(key, agent, repeated) / self.learner.reward_scale
        return jnp.clip(values, 0.0, 1.0).mean()
