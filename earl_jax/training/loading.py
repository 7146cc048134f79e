"""The trained lanes, policies and maps of visits of a run folder."""

import functools

import jax
import numpy as np

from earl_jax.algos import Learner, Method, learner_of
from earl_jax.envs import Env
from earl_jax.errors import InputError
from earl_jax.options.forks import require_jax
from earl_jax.options.jax_settings import package_types
from earl_jax.runs import policies
from earl_jax.runs.checkpoint import newest, restore
from earl_jax.runs.folder import RunFolder
from earl_jax.training.init import init_train_state
from earl_jax.training.plan import per_lane
from earl_jax.training.policy import Policy, policies_of
from earl_jax.training.state import LaneState, Problem, TrainState, seed_keys


def load_lanes(folder: RunFolder) -> tuple[Env, Method, LaneState]:
    """Return the env, method [N] and lanes [N] of a run folder's newest checkpoint.

    Raises:
        ValueError: the folder has no checkpoint yet, or its checkpoints are damaged.
    """
    if newest(folder.checkpoints):  # or else nothing is traced, which takes long for a report of many runs
        env, method, shapes = shapes_of(folder)
        state = restore(folder.checkpoints, shapes, with_replay=False)
        if state is not None:
            return env, method, state.lanes
    raise InputError(f"{folder.path} has no policies.npz and no checkpoint: they were deleted, or are not written yet")


def policies_at(folder: RunFolder) -> int:
    """Return the step of the newest task policies of a run folder; 0 without policies. Errors as `load_policies`."""
    return max(policies.policies_step(folder.policies), newest(folder.checkpoints))


@package_types()
def load_policies(folder: RunFolder) -> Policy:
    """Return the newest task policies of a run folder, one policy with leaves [N].

    After training with a budget for help, they are policies for the task without help. They come from policies.npz or
    from the newest checkpoint, whichever is newer. Loading policies.npz requires neither the class of the method nor,
    without a budget, the class of the task.

    Raises:
        ValueError: the folder has neither, or the newer one is damaged.
    """
    require_jax()
    saved = policies.policies_step(folder.policies)
    if saved == 0 or saved < newest(folder.checkpoints):
        return policies_of(*load_lanes(folder))
    config = folder.config
    obs_size, action_size = policies.policy_sizes(folder.policies)
    helped = config.build_setting().budget is not None
    budget_at = config.build_task().state_size if helped else None
    try:
        learner, unknown = config.build_method().learner, ""
    except InputError as error:  # the defaults of the method are not known
        try:
            learner, unknown = learner_of(config.options), f"; {error}"
        except InputError:
            raise error from None  # it names the file of the learner
    learner = per_lane(learner, len(config.seeds))

    def actor(learner: Learner) -> object:
        return learner.deployed(learner.init(jax.random.key(0), obs_size + helped, action_size + helped))

    like = jax.eval_shape(jax.vmap(actor), learner)
    try:
        actors = policies.load_policies(folder.policies, like)
    except InputError as error:
        raise InputError(f"{error}{unknown}") from error
    return Policy(learner, actors, obs_size, action_size, budget_at)


def load_visits(folder: RunFolder) -> tuple[Env, np.ndarray | None]:
    """Return the env of a run folder and the newest maps of visits [N, B, B] of its seeds; None if the task has no map.

    The maps come from policies.npz or from the newest checkpoint, whichever is newer.

    Raises:
        ValueError: the folder has neither, or the newer one is damaged.
    """
    env = folder.config.build_env()
    if env.map is None:
        return env, None
    saved, checkpoint = policies.policies_step(folder.policies), newest(folder.checkpoints)
    is_newer = saved and saved >= checkpoint
    visits = policies.load_visits(folder.policies, len(folder.config.seeds)) if is_newer else None
    if visits is None and saved and not checkpoint:
        raise InputError(f"{folder.policies} has no map of visits, and no checkpoint is left")
    return env, np.asarray(load_lanes(folder)[2].visits) if visits is None else visits


def shapes_of(folder: RunFolder, steps: int = 1) -> tuple[Env, Method, TrainState]:
    """Return the env, method [N] and the shapes of the train state of a run folder, with a replay for `steps` steps."""
    require_jax()
    config = folder.config
    env, method = config.build_env(), per_lane(config.build_method(), len(config.seeds))
    problem = Problem(env, config.protocol(env))
    init = functools.partial(init_train_state, problem, method, seed_keys(config.seeds), steps)
    return env, method, jax.eval_shape(init)
