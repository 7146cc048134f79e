"""The ARL formalism around a task: when the world is touched by hand, and how what was learnt is judged.

Source: Sharma et al. 2022, section 3 (deployed and continuing evaluation) and the released evaluation code.
"""

import dataclasses

import jax


@dataclasses.dataclass(frozen=True)
class Protocol:
    """How a life is lived and judged: hard interventions, and evaluations of the greedy task policy from s0 ~ rho."""

    train_horizon: int
    """H_T: steps between hard interventions, which put the world back to s0 ~ rho."""
    eval_horizon: int
    """H_E: steps of an evaluation episode."""
    eval_every: int = 10_000
    """Training steps between deployed evaluations."""
    eval_episodes: int = 10
    """Episodes of one deployed evaluation."""

    def __post_init__(self):
        for field in dataclasses.fields(self):
            if getattr(self, field.name) < 1:
                raise ValueError(f"{field.name} must be at least 1, not {getattr(self, field.name)}")

    def intervention_due(self, steps_lived: jax.Array) -> jax.Array:
        """Return whether a hard intervention follows the `steps_lived`-th step of a life."""
        return steps_lived % self.train_horizon == 0
