"""Training by name or by object, and its result."""

import contextlib
import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from earl_jax.algos import Method, method_for
from earl_jax.envs import Env, make, with_engine
from earl_jax.errors import InputError
from earl_jax.metrics.scores import DEFAULT, Score, Scores, Window, lifetime_scores
from earl_jax.options.jax_settings import package_types
from earl_jax.options.presets import ALGO
from earl_jax.options.schedule import Schedule
from earl_jax.options.seeds import SEEDS, seed_list
from earl_jax.options.values import TimeLimit
from earl_jax.protocol import SETTINGS, Deployment, Setting, setting_of, split_setting, with_explicit_horizon
from earl_jax.runs.config import RESERVED, RunConfig, deployed_metric
from earl_jax.runs.folder import RunFolder
from earl_jax.runs.hosts import first_host, gathered
from earl_jax.runs.logging import Log, check_logs
from earl_jax.training.forks import require_jax
from earl_jax.training.plan import Plan
from earl_jax.training.policy import Policy
from earl_jax.training.runner import Run, plan_runs, run_program
from earl_jax.training.state import TrainState


@dataclasses.dataclass
class Result:
    """The result of training: `steps [E]`, `metrics` of arrays [N, E], and the final `train_state` of N `seeds`.

    `engine` names the physics engine that stepped the task, or is `kinematic`. After a time limit they end early
    (`finished` is False). Before the first evaluation, `metrics` is empty.
    """

    config: RunConfig
    env: Env
    method: Method
    seeds: tuple[int, ...]
    steps: np.ndarray
    metrics: dict[str, np.ndarray]
    train_state: TrainState
    engine: str

    @property
    def step(self) -> int:
        """The steps that each seed was trained."""
        return int(gathered(self.train_state.step))

    @property
    def finished(self) -> bool:
        """Whether training reached its last step, rather than a time limit."""
        return self.step >= self.config.steps

    def score(self, window: Window = DEFAULT, metric: str | None = None) -> Score:
        """Return the score of the run: the mean over seeds of their evaluations in `window`, by default of the last tenth.

        `metric` is by default the deployed one.

        Raises:
            ValueError: training ended before the first evaluation.
        """
        return Score.of(self.steps, self.metrics, metric or deployed_metric(self.env), window)

    @property
    def scores(self) -> Scores:
        """The paper's scores of the lifetimes: J_D, D(A), C(A).

        Raises:
            ValueError: training ended before the first evaluation.
        """
        if not len(self.steps):
            raise InputError(f"there is no evaluation yet: training ended at step {self.step}")
        return lifetime_scores(self.steps, self.metrics, deployed_metric(self.env))

    def policy(self, lane: int = 0) -> Policy:
        """Return the greedy task policy of `seeds[lane]`, callable on obs [..., o] of the task without help."""
        return Policy.of(self.env, select_seed(self.method, lane), select_seed(self.train_state, lane))


@package_types()
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
    """Return the curves and the final state of `algo` on `env`, all seeds in one jitted program.

    Args:
        env: a name of `list_envs()` or an `Env`, which need not be registered.
        algo: a name of `list_algos()`, with its hyper-parameters in `options`, or a `Method`.
        setting: `deployment`, `continuing`, or a `Setting` object with its own interventions and budget.
        engine: the physics engine of a MuJoCo task: `auto`, `mjx`, `c` or `warp`; by default that of `env`.
        seeds: the number of seeds (0, 1, ...), a range such as "5:10", or a list of them. The randomness of a seed
            depends on no other seed; with another number of seeds in the program, its results agree to rounding.
        steps: training steps of each seed.
        eval_every: steps between evaluations; the last one is at `steps`.
        eval_episodes: greedy episodes of each deployed evaluation.
        out: a folder for config, metrics and checkpoints; None writes nothing.
        checkpoint_every: steps between checkpoints in `out`.
        logs: receivers of metrics in addition to metrics.csv: `tensorboard` or `wandb` (written into `out`), or an
            object with `log` and `close`.
        overwrite: remove the results of an earlier run in `out`, and name them on stderr. A folder with other files
            than a run's is refused.
        progress: show a progress bar; if stderr is not a terminal, print a line per evaluation.
        devices: the number of devices that share the lanes; by default one, or the devices of all hosts if jax runs on
            several.
        minutes: a limit of wall-clock time from this call on, compilation included. Training ends after the chunk of
            steps in which it runs out, at least one, and returns the `Result` so far; with `out`, a checkpoint of that
            step is saved, and `resume` continues it.
        options: hyper-parameters by name; a list has a value for each lane.

    Raises:
        ValueError: a name or an option is unknown, or numbers are inconsistent; the message gives the cause.
    """
    require_jax()
    limit = TimeLimit.of(minutes)
    task = with_engine(make(env) if isinstance(env, str) else env, engine)
    schedule = Schedule(steps, eval_every, eval_episodes, checkpoint_every)
    run = _new_run(task, algo, setting, options, seed_list(seeds), schedule)
    plan = plan_runs([run], devices)  # before the folder, so that an impossible plan creates none
    run.folder = _create_folder(out, run, plan.engine, logs, overwrite)
    run.listeners = [log for log in logs if not isinstance(log, str)]
    return _execute(plan, run, progress, limit)


def _new_run(
    env: Env,
    algo: str | Method,
    setting: str | Setting,
    options: dict[str, Any],
    seeds: tuple[int, ...],
    schedule: Schedule,
) -> Run:
    """Return the run of `algo` on `env`, with help if the setting has a budget. Errors as `train`."""
    env, setting = split_setting(env, setting_of(setting))
    env = setting.wrap(env)
    if isinstance(algo, str):
        method = method_for(env, algo, **options)
    elif options:
        raise InputError(
            f"options {', '.join(options)} go with an algo's name; this algo is an object: use .replace(...)"
        )
    else:
        method = algo
    return Run.resolve(RunConfig.from_objects(env, method, setting, seeds, schedule), env, method, setting)


@package_types()
def resume(
    folder: str | Path,
    *,
    env: Env | None = None,
    algo: Method | None = None,
    steps: int | None = None,
    progress: bool = False,
    devices: int | None = None,
    minutes: float | TimeLimit | None = None,
) -> Result:
    """Return the result of the run in `folder`, trained from its newest intact checkpoint to its end.

    On a CPU, the result is bit-identical to that of an uninterrupted run, because the same program runs. The same seed
    in a program with another number of lanes agrees to rounding, and on a CPU bit for bit where both have two or more.

    Args:
        folder: a run folder.
        env: the task, for a run that was trained on an object of a class that is not registered.
        algo: the method, likewise.
        steps: a new number of training steps.
        progress: show a progress bar; if stderr is not a terminal, print a line per evaluation.
        devices: the number of devices that share the lanes.
        minutes: a limit of wall-clock time, as in `train`; it counts from this call on.

    Raises:
        ValueError: `folder` is not a run folder or is damaged, rows of its metrics are missing, or the run's
            objects must be registered or passed.
    """
    require_jax()
    limit = TimeLimit.of(minutes)
    opened = RunFolder.open(Path(folder))
    opened.require_resumable()  # rather than after the training
    check_logs(opened.logs)
    config = opened.config if steps is None else opened.extended(steps)
    setting = config.build_setting()
    wrapped = None if env is None else setting.wrap(split_setting(env, setting)[0])
    run = Run.resolve(config, wrapped, algo)
    run.folder = opened
    return _execute(plan_runs([run], devices), run, progress, limit)


def _execute(plan: Plan, run: Run, progress: bool, limit: TimeLimit | None) -> Result:
    with run.folder.claimed() if run.folder else contextlib.nullcontext():
        train_state = run_program(plan, [run], progress, limit)
    return Result(
        config=run.config,
        env=run.env,
        method=run.method,
        seeds=run.config.seeds,
        steps=np.array(run.steps, int),
        metrics=run.metrics,
        train_state=train_state,
        engine=plan.engine,
    )


def _create_folder(
    out: str | Path | None, run: Run, engine: str, logs: Sequence[str | Log], overwrite: bool
) -> RunFolder | None:
    """Return the new folder of a run, or None without `out`; raise a ValueError before if a log can't be opened."""
    check_logs(logs)
    names = tuple(log for log in logs if isinstance(log, str))
    if out is None:
        if names:
            raise InputError(f"the log {names[0]} writes into a run folder: pass one with out=")
        return None
    path = Path(out)
    if not first_host():
        return RunFolder(path, run.config, names)
    return RunFolder.create(path, run.config, engine, names, overwrite)


def split_options(env: str, options: dict[str, Any]) -> tuple[Env, Setting, dict[str, Any]]:
    """Return the environment of the task `env`, its setting (`setting=NAME` in `options`) and the method's options.

    Raises:
        ValueError: the task or the setting is unknown, or one of their options is invalid.
    """
    rest = dict(options)
    name = rest.pop("setting", Deployment.name)
    known = {field.name for field in dataclasses.fields(setting_of(name))}
    fields = {field.name for field in dataclasses.fields(make(env))}
    task_options = {option: rest.pop(option) for option in list(rest) if option in fields}
    setting_options = {option: rest.pop(option) for option in list(rest) if option in known}
    for other, setting in SETTINGS.items():
        strays = {field.name for field in dataclasses.fields(setting)} & set(rest)
        if strays:
            raise InputError(f"{strays.pop()} is an option of the setting {other!r}, but the setting is {name!r}")
    task = make(env, **task_options)
    setting = with_explicit_horizon(setting_of(name, **setting_options), task, task_options)
    reserved = RESERVED & set(rest)
    if reserved:
        raise InputError(f"there is no option {min(reserved)!r}")
    return setting.wrap(task), setting, rest


def select_seed(state: Any, i: int) -> Any:
    """Return lane `i` of `state`: a `LaneState` out of a `TrainState`, or any tree of arrays with a leading lane axis.

    Raises:
        IndexError: there is no such lane.
    """
    lanes = state.lanes if isinstance(state, TrainState) else state
    count = jax.tree.leaves(lanes)[0].shape[0]
    if not -count <= i < count:
        raise IndexError(f"no lane {i}: there are {count}")
    return _lane(lanes, i)


@jax.jit
def _lane(lanes: Any, i: jax.Array) -> Any:
    """Return lane `i`, by one program for all leaves."""
    return jax.tree.map(lambda leaf: leaf[i], lanes)
