"""FBRL in the kitchen with the settings of VaPRL's released script, for differences 28, 30, 31 and 34.

earl-jax train mean_return_kitchen --algo released_fbrl --import benchmarks/paper/released_fbrl.py \
    --set controllers=1 random_steps=10000

The import also sets the release's upper bound of the policies' log standard deviations, for naive RL and R3L too.
"""

from typing import Any, ClassVar

import jax

import earl_jax
from benchmarks.paper.kitchen_variants import MeanReturnKitchen
from earl_jax.algos.fbrl import FBRL
from earl_jax.algos.learner import networks
from earl_jax.algos.method import Moment
from earl_jax.envs import Env

networks.LOG_STD_RANGE = (-20.0, 10.0)


class ReleasedFBRL(FBRL):
    """FBRL whose phases end on success with a dense reward too, a step later than those of a sparse task."""

    name: ClassVar[str] = "released_fbrl"

    def ends_phase(
        self, key: jax.Array, env: Env, agent: Any, obs: jax.Array, moment: Moment, method_state: Any
    ) -> jax.Array:
        return env.success(obs) | super().ends_phase(key, env, agent, obs, moment, method_state)


earl_jax.register_algo(ReleasedFBRL.name, ReleasedFBRL)
__all__ = ["MeanReturnKitchen"]
