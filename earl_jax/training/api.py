"""`train` and `resume`: training of tasks and methods that are given by name or as objects."""

import contextlib
import dataclasses
import os
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from earl_jax.algos import Method, has_default_scale
from earl_jax.envs import Env, with_engine, without_budget
from earl_jax.errors import InputError, brief
from earl_jax.metrics.continuing import mostly_faults
from earl_jax.options.forks import require_jax
from earl_jax.options.jax_settings import package_types
from earl_jax.options.presets import ALGO
from earl_jax.options.schedule import Schedule
from earl_jax.options.seeds import SEEDS, seed_list
from earl_jax.options.values import COUNT, TimeLimit, require, require_object
from earl_jax.protocol import Deployment, Setting
from earl_jax.runs.checkpoint import newest
from earl_jax.runs.config import RunConfig
from earl_jax.runs.contents import has_results
from earl_jax.runs.files import warn
from earl_jax.runs.folder import RunFolder
from earl_jax.runs.hosts import failing_at_once, first_host
from earl_jax.runs.logging import Log, check_logs
from earl_jax.runs.policies import policies_step
from earl_jax.training.build import build
from earl_jax.training.result import Result
from earl_jax.training.runner import Program, Run
from earl_jax.training.stopping import Stopped


@package_types()
@failing_at_once()
def train(
    env: str | Env,
    algo: str | Method = ALGO,
    *,
    setting: str | Setting = Deployment.name,
    engine: str | None = None,
    seeds: int | str | Sequence[int] = SEEDS,
    steps: int = Schedule.steps,
    eval_every: int = Schedule.eval_every,
    eval_episodes: int = Schedule.eval_episodes,
    out: str | Path | None = None,
    checkpoint_every: int = Schedule.checkpoint_every,
    logs: Sequence[str | Log] = (),
    overwrite: bool = False,
    progress: bool = False,
    devices: int | None = None,
    minutes: float | TimeLimit | None = None,
    **options: Any,
) -> Result:
    """Train `algo` on `env`, all seeds in one jitted program, and return the `Result`: curves, policies, final state.

    Args:
        env: a name of `list_envs()` or an `Env`, which need not be registered.
        algo: a name of `list_algos()`, with its hyper-parameters in `options`, or a `Method`.
        setting: `deployment`, `continuing`, or a `Setting` object with its own interventions and budget.
        engine: the physics engine of a MuJoCo task: `auto`, `mjx`, `c` or `warp`; by default the engine of `env`.
        seeds: the number of seeds (0, 1, ...), a range such as "5:10", or a list of seeds. The randomness of a seed
            does not depend on other seeds; its results agree up to rounding if the program trains another number of
            seeds.
        steps: training steps of each seed.
        eval_every: steps between evaluations; the last evaluation is at `steps`.
        eval_episodes: greedy episodes of each deployed evaluation.
        out: a folder for config, metrics and checkpoints; None writes nothing.
        checkpoint_every: steps between checkpoints in `out`.
        logs: receivers of metrics in addition to metrics.csv: `tensorboard` or `wandb` (written into `out`), or an
            object with `log` and `close`.
        overwrite: remove the results of an earlier run in `out`, and list them on stderr. A folder that contains files
            of anything but a run is refused.
        progress: show a progress bar; if stderr is not a terminal, print a line per evaluation.
        devices: the number of devices that share the lanes; by default one, or the devices of all hosts if jax runs on
            several.
        minutes: a limit of wall-clock time from this call on, compilation included. When the time runs out, training
            ends after the current chunk of steps and returns the `Result` so far; at least one chunk runs. With `out`,
            a checkpoint of that step is saved, from which `resume` continues.
        options: options of the task, the setting and the method by name. A hyper-parameter can be a list with a value
            for each lane. Options of an `env` or a `setting` that is an object must be set in the object.

    Raises:
        ValueError: a name or an option is unknown, or numbers are inconsistent; the message gives the cause.
    """
    require_jax()
    require_object("task", env, Env)
    require_object("method", algo, Method)
    limit = TimeLimit.of(minutes)
    schedule = Schedule(steps, eval_every, eval_episodes, checkpoint_every)
    run = make_run(env, algo, {**options, "setting": setting}, seeds, schedule, engine)
    if not isinstance(algo, str):
        _warn_of_scale(run.env, algo)
    program = Program([run], devices)  # before the folder, so that an impossible plan creates none
    if overwrite:
        program.trace()  # an error in a function of the task or the method leaves the earlier run as it is
    run.folder = _create_folder(out, run, program.plan.engine, logs, overwrite)
    run.listeners = [log for log in logs if not isinstance(log, str)]
    return _execute(program, run, progress, limit)


def make_run(
    env: str | Env, algo: str | Method, options: dict[str, Any], seeds: Any, schedule: Schedule, engine: str | None
) -> Run:
    """Return the run that arguments of `train` describe, without a folder and logs. Errors as `train`."""
    task, method, setting = build(env, algo, options)
    task = with_engine(task, engine)
    config = RunConfig.from_objects(task, method, setting, seed_list(seeds), schedule)
    return Run.resolve(config, task, method)


def _warn_of_scale(env: Env, method: Method) -> None:
    """Warn if a method that was passed as an object has its learner's default reward scale, and `env` has another."""
    default, own = type(method.learner).reward_scale, env.reward_scale
    if own != default and has_default_scale(method.learner):
        scales = f"reward_scale is {default:g}, the learner's default, but {env.name} has {own:g}"
        warn(f"{scales}; make the method with earl_jax.method_for to use that")


@package_types()
@failing_at_once()
def resume(
    folder: str | Path,
    *,
    env: Env | None = None,
    algo: Method | None = None,
    steps: int | None = None,
    progress: bool = False,
    devices: int | None = None,
    minutes: float | TimeLimit | None = None,
    logs: Sequence[Log] = (),
) -> Result:
    """Train the run in `folder` from its newest intact checkpoint to its end, and return its `Result`.

    On a CPU, the result is bit-identical to that of an uninterrupted run, because the same program runs. The same seed
    in a program with another number of lanes agrees up to rounding.

    Args:
        folder: a run folder.
        env: the task with the options of the run; needed only if its class is not registered.
        algo: the method with the options of the run; needed only if its class is not registered.
        steps: a new total number of training steps; by default the run keeps its own.
        progress: show a progress bar; if stderr is not a terminal, print a line per evaluation.
        devices: the number of devices that share the lanes.
        minutes: a limit of wall-clock time, as in `train`; it counts from this call on.
        logs: objects that receive the metrics, in addition to the logs that `train` was given by name.

    Raises:
        ValueError: `folder` is not a run folder or is damaged, rows of its metrics are missing, its checkpoints were
            removed, `env` or `algo` has other options than the run, or its class is neither registered nor passed.
    """
    require_jax()
    for noun, given, kind in (("task", env, Env), ("method", algo, Method)):
        if given is not None:
            require_object(noun, given, kind, or_name=False)
    limit = TimeLimit.of(minutes)
    opened = RunFolder.open(folder)
    step = opened.require_resumable().step  # rather than after the training
    require_checkpoint(opened, step)
    if not isinstance(logs, Sequence) or any(isinstance(log, str) for log in logs):
        raise InputError(f"resume takes a list of log objects, not {brief(logs)}; logs named in train continue anyway")
    check_logs([*opened.logs, *logs])
    config = opened.config if steps is None else _extended(opened, steps, step)
    if step and not newest(opened.checkpoints):
        warn(f"{opened.path} has no checkpoint yet, so its {step:,} steps are trained again")
    task = None if env is None else without_budget(env)
    config.require_objects(task, algo)
    run = Run.resolve(config, task and config.build_setting().wrap(task), algo)
    run.folder, run.listeners = opened, logs
    return _execute(Program([run], devices), run, progress, limit)


def _extended(folder: RunFolder, steps: int, step: int) -> RunConfig:
    """Return the config of a run that is at `step` with the new length `steps`; an InputError if that is unfit."""
    require("steps", steps, COUNT)
    reached, every = max(step, newest(folder.checkpoints)), folder.config.eval_every
    if steps < reached:
        raise InputError(f"{folder.path} has {reached} steps already, more than {steps}")
    if steps % every:
        raise InputError(
            f"steps {steps} is not a multiple of {every}, the run's eval_every; choose {-(-steps // every) * every}"
        )
    if steps < folder.config.steps:
        warn(f"{folder.path} now ends at step {steps:,} instead of {folder.config.steps:,}")
    return dataclasses.replace(folder.config, steps=steps)


def require_checkpoint(folder: RunFolder, step: int) -> None:
    """Raise an InputError if the checkpoints of a run whose metrics end at `step` were removed: it would start anew.

    A run that ended before its first checkpoint does start anew. It has a folder for them, which copies of runs lack.
    """
    if newest(folder.checkpoints):
        return
    path, config = folder.path, folder.config
    step = max(step, policies_step(folder.policies))
    is_copy = has_results(path) and not folder.checkpoints.is_dir()
    if is_copy or step == config.steps or step - config.eval_every >= config.checkpoint_every:
        state = "is finished" if step == config.steps else f"has reached step {step:,}"
        name = shlex.quote(str(path))
        raise InputError(
            f"{path} {state} ({config.steps:,} steps) and has no checkpoint; earl_jax.load({str(path)!r}) or "
            f"earl-jax show {name} reads it; to train it again: earl-jax train --config {name} --out NEW"
        )


def _execute(program: Program, run: Run, progress: bool, limit: TimeLimit | None) -> Result:
    with run.folder.claimed() if run.folder else contextlib.nullcontext():
        try:
            train_state = program.run(progress, limit)
        except Stopped as stopped:
            stopped.result = run.result(stopped.state, program.plan.engine)
            raise
    if not progress:
        _warn_of_faults(run)
    return run.result(train_state, program.plan.engine)


def _warn_of_faults(run: Run) -> None:
    """Warn if most steps of a lane were faults, as the lines of `progress` do."""
    table = run.table
    if table.step and (broken := mostly_faults(table.metrics["faults"][:, -1], table.step)).any():
        problem = "lanes had faults in most of their steps, from which nothing is learnt"
        warn(f"{broken.sum()} of {len(broken)} {problem}")


def _create_folder(
    out: str | Path | None, run: Run, engine: str, logs: Sequence[str | Log], overwrite: bool
) -> RunFolder | None:
    """Return the new folder of a run, or None without `out`; raise a ValueError beforehand if a log can't be opened."""
    check_logs(logs)
    names = tuple(log for log in logs if isinstance(log, str))
    if out is None:
        if names:
            raise InputError(f"the log {names[0]} writes into a run folder: pass one with out=")
        return None
    path = Path(os.path.expanduser(out))
    if not first_host():
        return RunFolder(path, run.config, names)
    return RunFolder.create(path, run.config, engine, names, overwrite)
