"""Variants of R3L that may explain difference 12: `earl-jax train TASK --algo NAME --import benchmarks/paper/r3l_variants.py`."""

from typing import ClassVar

import jax

import earl_jax
from earl_jax.algos.method import BACKWARD, FORWARD, Phase
from earl_jax.algos.r3l import R3L, RND


class R3LErrorScale(R3L):
    """R3L whose novelty is divided by the running standard deviation of the error, not of the scaled error."""

    name: ClassVar[str] = "r3l_error_scale"

    def distil(self, rnd: RND, states: jax.Array) -> RND:
        spread = rnd.error(rnd.predictor, states, self.learner.precision).std()
        sigma = self.rnd_decay * rnd.sigma + (1 - self.rnd_decay) * spread
        return super().distil(rnd, states).replace(sigma=sigma)


class R3LPerturbationDemos(R3L):
    """R3L whose perturbation controller receives the demonstrations of both directions."""

    name: ClassVar[str] = "r3l_perturbation_demos"

    @property
    def phases(self) -> tuple[Phase, ...]:
        return Phase(), Phase((FORWARD, BACKWARD), controller=1, ends_on_success=False)


earl_jax.register_algo(R3LErrorScale.name, R3LErrorScale)
earl_jax.register_algo(R3LPerturbationDemos.name, R3LPerturbationDemos)
