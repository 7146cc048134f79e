"""More seeds for a finished run: they are trained from step 0 to its end, and then its files hold all of them."""

import dataclasses
import functools
from collections.abc import Sequence
from pathlib import Path

import jax
import numpy as np

from earl_jax.algos import Method
from earl_jax.envs import Env
from earl_jax.errors import InputError
from earl_jax.protocol import split_setting
from earl_jax.runs.checkpoint import newest, restore_together, save
from earl_jax.runs.config import RunConfig
from earl_jax.runs.folder import RunFolder
from earl_jax.runs.growth import merge, missing_seeds, new_seeds_folder
from earl_jax.time_limit import TimeLimit
from earl_jax.training.demo_rows import replay_capacity
from earl_jax.training.init import init_train_state
from earl_jax.training.plan import Plan
from earl_jax.training.runner import Run, plan_runs, run_program, save_policies_of
from earl_jax.training.state import Problem, TrainState, seed_keys
from earl_jax.training.stopping import Stopped


def add_seeds(
    path: Path,
    seeds: Sequence[int],
    env: Env | None = None,
    method: Method | None = None,
    progress: bool = False,
    devices: int | None = None,
    limit: TimeLimit | None = None,
) -> tuple[Plan, Run, TrainState] | None:
    """Train those of `seeds` that the finished run at `path` lacks, and merge them into its folder.

    Returns None if the folder has all of them then, and the plan, the run and the state of the new seeds where the `limit`
    ended their training. The same call continues it. On a CPU, the files are byte for byte those of a run of all seeds
    at once, where two or more seeds were trained before and now; a lane alone in a program agrees to rounding.

    Raises:
        ValueError: the run is not finished, its checkpoint is gone, it has values for each seed, or the new seeds would
            have another physics engine.
        Stopped: SIGINT or SIGTERM arrived; a checkpoint of the new seeds is saved.
    """
    folder = RunFolder.open(path)
    missing = missing_seeds(folder.config, seeds)
    if not missing:
        return None
    _require_addable(folder, method or folder.config.build_method())
    config = dataclasses.replace(folder.config, seeds=missing)
    run = Run.resolve(config, _wrapped(config, env), method)
    plan = plan_runs([run], devices)
    _require_engine(folder, plan.engine)
    with folder.claimed():
        run.folder = new_seeds_folder(folder, missing, plan.engine)
        with run.folder.claimed():
            try:
                state = run_program(plan, [run], progress, limit)
            except Stopped as stopped:
                raise Stopped(stopped.number, stopped.step, [path], missing) from None
        if int(state.step) < config.steps:
            return plan, run, state
        merge(folder, run.folder, functools.partial(_write_state, folder, run))
    return None


def _wrapped(config: RunConfig, env: Env | None) -> Env | None:
    setting = config.build_setting()
    return None if env is None else setting.wrap(split_setting(env, setting)[0])


def _require_addable(folder: RunFolder, method: Method) -> None:
    """Raise an InputError if no seeds can be added to the run in `folder`."""
    path, steps, step = folder.path, folder.config.steps, newest(folder.checkpoints)
    if jax.process_count() > 1:
        raise InputError("seeds are added on one host")
    if step < steps:
        is_removed = not step and folder.policies.exists()
        remedy = (
            "without its checkpoint a run takes no seeds; train them in a folder of their own with: earl-jax train --config"
            if is_removed
            else f"finish it first with: earl-jax resume {path}"
        )
        raise InputError(f"{path} has no checkpoint of its last step {steps}; {remedy}")
    folder.require_rows()
    if any(np.ndim(leaf) for leaf in jax.tree.leaves(method)):
        raise InputError(f"{path} has a hyper-parameter with a value for each seed, so there is none for further seeds")


def _require_engine(folder: RunFolder, engine: str) -> None:
    if folder.engine not in (None, engine):
        raise InputError(
            f"{folder.path} was trained with the physics engine {folder.engine}, and here it would be {engine}; train the "
            f"seeds in a folder of their own with: earl-jax train --config {folder.path} --engine ..."
        )


def _write_state(folder: RunFolder, run: Run, merged: RunFolder) -> None:
    """Write policies.npz and the checkpoint of all seeds of both runs to the folder `merged`."""
    assert run.folder is not None
    whole = Run.resolve(merged.config, run.env, jax.tree.map(lambda leaf: leaf[0], run.method))
    whole.folder = merged
    problem, lanes = Problem(run.env, run.protocol), len(merged.config.seeds)
    capacity = replay_capacity(problem, whole.method, merged.config.steps)
    init = functools.partial(init_train_state, problem, whole.method, seed_keys(merged.config.seeds), capacity)
    folders = [folder.checkpoints, run.folder.checkpoints]
    state = restore_together(folders, [lanes - len(run.config.seeds), len(run.config.seeds)], jax.eval_shape(init))
    save_policies_of([whole], state, merged.config.steps)
    save(merged.checkpoints, state)
