"""The tasks in brax's Env convention: `wrap("sawyer_door")` for brax's wrappers, trainers and whatever else takes such envs.

Written for brax 0.14.2. On jax 0.10 and later its own trainers stop with `AttributeError: jax.device_put_replicated`, which jax
removed; on jax 0.9.2 its SAC and PPO train through this adapter (docs/adapters.md has the commands).
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
from brax.envs.base import Env as BraxEnv
from brax.envs.base import State as BraxState
from brax.envs.wrappers import training

from earl_jax.adapters._world import Moment, World
from earl_jax.envs import Env

UNCUT = 2**30
"""More steps than anything lives in float32, in which brax counts them."""


def wrap(task: str | Env, mode: str = "train", **options: Any) -> "LifeEnv":
    """Return `task` as a brax env, one life (`train`) or episodes (`eval`), which `adapters.gymnasium.LifeEnv` describes.

    Args:
        task: a name of `list_envs()` or an `Env`.
        mode: `train`, or `eval`, where brax's `EpisodeWrapper` ends the episodes.
        options: `setting`, `attempt_steps`, and the task's own.

    Raises:
        ValueError: an unknown mode, setting, option or name; the message lists the choices.
    """
    return LifeEnv(World.of(task, mode=mode, **options))


def wrap_for_training(
    env: BraxEnv, episode_length: int, action_repeat: int = 1, randomization_fn: Any = None
) -> BraxEnv:
    """Return `env` as brax's `training.wrap` does, but a life uncut: the `wrap_env_fn` of brax's trainers for such envs."""
    living = isinstance(env, LifeEnv) and env.world.living
    return training.wrap(env, UNCUT if living else episode_length, action_repeat, randomization_fn)


class LifeEnv(BraxEnv):
    """A `World` whose `pipeline_state` is the whole life, so that a wrapper that puts it back puts back the goal as well.

    brax's `AutoResetWrapper` returns a lane to the very state that it first had: the same start, goal and randomness each time.
    Its `EpisodeWrapper` and trainers take raw keys (`jax.random.PRNGKey`) only; `reset` alone takes typed ones as well.
    """

    def __init__(self, world: World):
        self.world = world

    def reset(self, rng: jax.Array) -> BraxState:
        """Return a state with s0 ~ rho and a task goal drawn uniformly, from a raw or a typed key `rng`."""
        typed = jnp.issubdtype(rng.dtype, jax.dtypes.prng_key)
        life = self.world.born(rng if typed else jax.random.wrap_key_data(rng))
        moment = self.world.first(life)
        pipeline_state: Any = life
        return BraxState(
            pipeline_state, moment.obs, moment.reward, self._done(moment), _metrics(moment, life.interventions)
        )

    def step(self, state: BraxState, action: jax.Array) -> BraxState:
        """Return the state after one control step with `action [a]`; metrics are of this step, so that brax's sums count."""
        before: Any = state.pipeline_state
        life, moment = self.world.step(before, action)
        return dataclasses.replace(
            state,
            pipeline_state=life,
            obs=moment.obs,
            reward=moment.reward,
            done=self._done(moment),
            metrics={**state.metrics, **_metrics(moment, before.interventions)},
        )

    def _done(self, moment: Moment) -> jax.Array:
        over = moment.ended if self.world.living else moment.ended | moment.fault
        return over.astype(jnp.float32)

    @property
    def observation_size(self) -> int:
        """Length s + g of `obs`."""
        return self.world.env.obs_size

    @property
    def action_size(self) -> int:
        """Length of an action."""
        return self.world.env.action_size

    @property
    def backend(self) -> str:
        """What moves this world: a physics engine's name, or `kinematic`."""
        return self.world.env.engine


def _metrics(moment: Moment, before: jax.Array) -> dict[str, jax.Array]:
    interventions = moment.interventions - before
    return {"success": moment.success.astype(jnp.float32), "interventions": interventions.astype(jnp.float32)}
