"""Commands that train one run: train, resume."""

import inspect
from pathlib import Path
from typing import Any, Literal

from earl_jax.cli.arguments import (
    JSON,
    SEEDS,
    Devices,
    Engine,
    Hosts,
    Logs,
    Minutes,
    Positional,
    Seeds,
    Set,
    emit,
    parse_minutes,
    parse_options,
)
from earl_jax.errors import InputError
from earl_jax.options.presets import ALGO, LENGTHS
from earl_jax.options.presets import preset as named_preset
from earl_jax.options.values import parse_seeds


def train(
    env: Positional[str | None] = None,
    algo: str = ALGO,
    learner: str | None = None,
    seeds: Seeds = None,
    steps: int | None = None,
    out: Path = Path("runs/latest"),
    config: Path | None = None,
    preset: str | None = None,
    eval_every: int | None = None,
    eval_episodes: int | None = None,
    checkpoint_every: int | None = None,
    setting: Literal["deployment", "continuing"] = "deployment",
    engine: Engine = None,
    devices: Devices = None,
    hosts: Hosts = None,
    minutes: Minutes = None,
    log: Logs = (),
    overwrite: bool = False,
    set: Set = (),
    json: JSON = False,
) -> None:
    """Train a method on a task without resets, all seeds in one program.

    Args:
        env: Task, a name from `earl-jax list`.
        algo: Method, a name from `earl-jax list`.
        learner: Learner of the method, a name from `earl-jax list`. By default sac.
        seeds: A number of seeds, counted from 0; a range such as 5:10, which ends before 10; or a list such as 3 5 8. By
            default 5, or those of --config or --preset.
        steps: Training steps of each seed. By default 100,000, or those of --preset.
        out: New folder for config.json, metrics.csv and checkpoints.
        config: Run folder, or a config.json, of a run to repeat, in place of the task, the method and their options. --seeds
            takes other seeds. By default none.
        preset: Lengths, seeds and options by name, from `earl-jax list`; what is given besides wins. By default none.
        eval_every: Steps between evaluations. By default 10,000, or those of --preset.
        eval_episodes: Greedy episodes of each deployed evaluation. By default 10, or those of --preset.
        checkpoint_every: Steps between checkpoints. By default 100,000, or those of --preset.
        setting: deployment scores the final policy; continuing, the rewards during training (docs/formalism.md).
        overwrite: Remove the results of an earlier run in the folder. A folder with other files is refused.
    """
    limit = parse_minutes(minutes)
    from earl_jax.runs.hosts import join_hosts
    from earl_jax.training import api

    join_hosts(hosts)
    every = {"eval_every": eval_every, "eval_episodes": eval_episodes, "checkpoint_every": checkpoint_every}
    given = {
        "algo": algo,
        "learner": learner,
        "steps": steps,
        **every,
        "preset": preset,
        "setting": setting,
        "set": set,
    }
    task, values = _objects_by_name(env, given) if config is None else _objects_of_run(config, env, given)
    if seeds is not None:
        values["seeds"] = parse_seeds(seeds, SEEDS)
    values |= {"engine": engine, "out": out, "logs": log, "overwrite": overwrite, "devices": devices}
    result = api.train(task, **values, progress=True, minutes=limit)
    _emit_result(result, out, json)


def _objects_by_name(env: str | None, given: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
    """Return the task `env`, and the arguments of `api.train` for the options `given`."""
    from earl_jax import algos
    from earl_jax.training import api

    if env is None:
        raise InputError("train needs a task, a name from `earl-jax list`, or --config with a run to repeat")
    pairs, name = parse_options(given["set"]), given["preset"]
    lengths = {key: value for key, value in given.items() if key in LENGTHS and value is not None}
    values = {**LENGTHS, **lengths} if name is None else named_preset(name, env, **lengths)
    options = {key: value for key, value in values.items() if key not in LENGTHS}
    task, setting, options = api.split_options(env, {**options, "setting": given["setting"], **pairs})
    lengths = {key: values[key] for key in LENGTHS}
    options = options if given["learner"] is None else {"learner": given["learner"], **options}
    return task, {**lengths, "setting": setting, "algo": algos.method_for(task, given["algo"], **options)}


def _objects_of_run(path: Path, env: str | None, given: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
    """Return the task of the run at `path`, and the arguments of `api.train` that repeat it.

    Raises:
        ValueError: there is no valid config at `path`, or a task or an option is given too.
    """
    from earl_jax.runs.folder import RunFolder, read_config

    defaults = inspect.signature(train).parameters
    changed = [f"--{name.replace('_', '-')}" for name, value in given.items() if value != defaults[name].default]
    if env is not None or changed:
        named = ", ".join(changed) or f"the task {env!r}"
        raise InputError(f"--config repeats a run as it is: leave out {named}")
    if not path.exists():
        raise InputError(f"--config takes a run folder or a config.json, and {path} does not exist")
    config = RunFolder.open(path).config if path.is_dir() else read_config(path)[0]
    values = {name: getattr(config, name) for name in LENGTHS}
    return config.build_env(), {**values, "algo": config.build_method(), "setting": config.build_setting()}


def resume(
    folder: Positional[Path],
    steps: int | None = None,
    devices: Devices = None,
    hosts: Hosts = None,
    minutes: Minutes = None,
    json: JSON = False,
) -> None:
    """Resume a run from its newest checkpoint. On a CPU the result is bit-identical to that of an uninterrupted run.

    Args:
        folder: Run folder.
        steps: New length of the run. By default the run keeps its length.
    """
    limit = parse_minutes(minutes)
    from earl_jax.runs.hosts import join_hosts
    from earl_jax.training import api

    join_hosts(hosts)
    result = api.resume(folder, steps=steps, progress=True, devices=devices, minutes=limit)
    _emit_result(result, folder, json)


def _emit_result(result: Any, out: Path, as_json: bool) -> None:
    """Print the deployed score of `result` over its seeds, and how to continue it after a time limit.

    Before the first evaluation there is no score.
    """
    from earl_jax.training.stopping import resume_command

    values, text = _score(result) if len(result.steps) else ({"steps": 0}, "no evaluation yet")
    values = {"out": str(out), "engine": result.engine, **values, "stopped": not result.finished}
    if not result.finished:
        command = resume_command(out)
        values |= {"step": result.step, "resume": command}
        text += f"\nstopped at step {result.step} of {result.config.steps}, the minutes have run out; "
        text += f"continue with: {command}"
    emit(values, as_json, f"{out}: {text}")


def _score(result: Any) -> tuple[dict[str, Any], str]:
    """Return the newest deployed score of `result` over its seeds, as JSON values and as text."""
    from earl_jax.metrics.continuing import DIVERGED, count_diverged, diverged_text
    from earl_jax.metrics.deployed import WIDE
    from earl_jax.metrics.statistics import summarise
    from earl_jax.runs.config import deployed_metric

    metric = deployed_metric(result.env)
    score = summarise(result.metrics[metric][:, -1])
    diverged = count_diverged(result.metrics)
    values = {"steps": int(result.steps[-1]), metric: score._asdict(), DIVERGED: diverged}
    text = f"{metric} {score.mean:.3f} (stderr {score.stderr:.3f}) over {score.seeds} seeds"
    if WIDE in result.metrics:
        wide = summarise(result.metrics[WIDE][:, -1])
        values[WIDE], text = wide._asdict(), f"{text}, {wide.mean:.3f} from wide starts"
    return values, text + diverged_text(diverged, score.seeds)
