"""The trained lanes of a run folder."""

import functools

import jax

from earl_jax.algos import Method
from earl_jax.envs import Env
from earl_jax.runs.checkpoint import restore
from earl_jax.runs.folder import RunFolder
from earl_jax.training.demo_rows import replay_capacity
from earl_jax.training.init import init_train_state
from earl_jax.training.plan import per_lane
from earl_jax.training.state import LaneState, Problem, seed_keys


def load_lanes(folder: RunFolder) -> tuple[Env, Method, LaneState]:
    """Return the env, method [N] and lanes [N] of a run folder's newest checkpoint.

    Raises:
        ValueError: the folder has no checkpoint yet, or its checkpoints are damaged.
    """
    config = folder.config
    env, method = config.build_env(), per_lane(config.build_method(), len(config.seeds))
    problem = Problem(env, config.protocol(env))
    capacity = replay_capacity(problem, method, 1)
    shape = jax.eval_shape(functools.partial(init_train_state, problem, method, seed_keys(config.seeds), capacity))
    state = restore(folder.checkpoints, shape, with_replay=False)
    if state is None:
        raise ValueError(f"{folder.path} has no checkpoint yet; continue the run with: earl-jax resume {folder.path}")
    return env, method, state.lanes
