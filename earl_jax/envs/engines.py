"""The physics engine of a task: the one chosen, the one that runs, and how to change it. Kinematic tasks have none."""

import dataclasses

from earl_jax.envs.base import Env
from earl_jax.envs.help_budget import HelpBudget, without_budget
from earl_jax.envs.mujoco_env import MujocoEnv
from earl_jax.errors import InputError
from earl_jax.physics import fastest_engine


def chosen_engine(env: Env) -> str:
    """Return the physics engine of `env` as chosen: its name, `auto`, or `kinematic`."""
    task = without_budget(env)
    return task.engine if isinstance(task, MujocoEnv) else "kinematic"


def for_lanes(env: Env, lanes: int) -> Env:
    """Return `env` with the physics engine `auto` replaced by the fastest one for a batch of `lanes`."""
    task = without_budget(env)
    if not isinstance(task, MujocoEnv) or task.engine != "auto":
        return env
    return with_engine(env, fastest_engine(task.engine_cost, lanes))


def with_engine(env: Env, engine: str | None) -> Env:
    """Return `env` with the physics engine `engine`, or unchanged for None.

    Raises:
        ValueError: the engine is unknown or not installed, or the task has no physics engine; the message gives the
            cause.
    """
    if engine is None:
        return env
    if isinstance(env, HelpBudget):
        return dataclasses.replace(env, task=with_engine(env.task, engine))
    if not isinstance(env, MujocoEnv):
        raise InputError(f"{env.name} is plain arithmetic: it has no physics engine to choose")
    return dataclasses.replace(env, engine=engine)
