"""Commands that train one run: train, resume."""

import dataclasses
import inspect
import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from earl_jax.cli.arguments import Logs, Positional, Seeds, Texts, emit, parse_minutes, parse_options, stopping
from earl_jax.cli.descriptions import stored
from earl_jax.errors import InputError
from earl_jax.options.imports import resume_command
from earl_jax.options.presets import ALGO, Preset, named_preset
from earl_jax.options.schedule import Schedule

if TYPE_CHECKING:
    from earl_jax.algos import Method
    from earl_jax.envs import Env
    from earl_jax.protocol import Setting
    from earl_jax.rendering import VideoLog
    from earl_jax.report.runs import Curves


def train(
    env: Positional[str | None] = None,
    algo: str | None = None,
    learner: str | None = None,
    seeds: Seeds = None,
    steps: int | None = None,
    out: Path = Path("runs/latest"),
    config: Path | None = None,
    preset: str | None = None,
    eval_every: int | None = None,
    eval_episodes: int | None = None,
    checkpoint_every: int | None = None,
    setting: Literal["deployment", "continuing"] | None = None,
    engine: str | None = None,
    devices: int | None = None,
    hosts: str | None = None,
    minutes: str | None = None,
    log: Logs = (),
    videos: int | None = None,
    overwrite: bool = False,
    set: Texts = (),
    json: bool = False,
) -> None:
    """Train a method on a task without resets, all seeds in one program.

    Args:
        env: Task, a name from `earl-jax list`.
        algo: Method, a name from `earl-jax list`. By default fbrl.
        learner: Learner of the method, a name from `earl-jax list`. By default sac.
        seeds: A number of seeds, counted from 0; a range such as 5:10, which ends before 10; or a list such as 3 5 8. By
            default 5, or those of --config or --preset.
        steps: Training steps of each seed. By default 100,000, or those of --preset.
        out: New folder for config.json, metrics.csv and checkpoints.
        config: Run folder or config.json of a run to repeat, instead of a task, a method and options. --seeds replaces
            its seeds. By default none.
        preset: Seeds, schedule and options by name, from `earl-jax list`; other arguments override them. By default none.
        eval_every: Steps between evaluations. By default 10,000, or those of --preset.
        eval_episodes: Greedy episodes of each deployed evaluation. By default 10, or those of --preset.
        checkpoint_every: Steps between checkpoints. By default 100,000, or those of --preset.
        setting: Who chooses task goals: in deployment, each attempt draws one; in continuing, the environment changes it on a
            schedule (docs/formalism.md). By default deployment.
        videos: Number of videos of the first seed's policy, spread evenly over the evaluations, the last one at the end. They
            go to the folder videos in --out and to the loggers of --log. A resumed run continues them. They need the extra
            render. By default none.
        overwrite: Remove the results of an earlier run in the folder. A folder with any other files is refused.
    """
    limit = parse_minutes(minutes)
    from earl_jax.runs.hosts import failing_at_once, join_hosts
    from earl_jax.training import api

    join_hosts(hosts)
    with failing_at_once(), stopping(json, {"out": str(out), "resume": resume_command(out)}):
        lengths = {
            "steps": steps,
            "eval_every": eval_every,
            "eval_episodes": eval_episodes,
            "checkpoint_every": checkpoint_every,
        }
        named = {"learner": learner, "setting": setting}
        given = {name: value for name, value in named.items() if value is not None}
        options = given | parse_options(itertools.chain(*set), [*given, *["engine"] * (engine is not None)])
        if config is None:
            task, method, rules, known_seeds, schedule = _by_name(env, algo, preset, steps, options)
        else:
            _refuse_changes(env, algo=algo, **named, **lengths, preset=preset, set=set)
            task, method, rules, known_seeds, schedule = _of_run(config)
        result = api.train(
            task,
            method,
            setting=rules,
            engine=engine,
            seeds=known_seeds if seeds is None else seeds,
            **dataclasses.asdict(schedule.changed(**lengths)),
            out=out,
            logs=[*itertools.chain(*log), *_video_logs(videos)],
            overwrite=overwrite,
            progress=True,
            devices=devices,
            minutes=limit,
        )
    _emit_result(result, out, json)


def refuse_options(arguments: Sequence[str]) -> None:
    """Raise an InputError that names `--set` where `arguments` of `train` have an option of a task or a method."""
    flags = [argument.partition("=")[0] for argument in arguments if argument.startswith("--")]
    given = {flag[2:].replace("-", "_"): flag for flag in flags}
    unknown = given.keys() - inspect.signature(train).parameters.keys()
    known = {"options": stored()["shared"]}, *stored().values()
    for name in sorted(unknown & {name for described in known for name in described.get("options", {})}):
        raise InputError(f"{given[name]} is an option of a task or a method: --set {name}=VALUE")


def _by_name(
    env: str | None, algo: str | None, preset: str | None, steps: int | None, options: dict[str, Any]
) -> tuple["Env", "Method", "Setting", int, Schedule]:
    """Return the task, method, setting, number of seeds and schedule that names and `options` describe."""
    from earl_jax.training.build import build

    if env is None:
        raise InputError("train needs a task, a name from `earl-jax list`, or --config with a run to repeat")
    chosen = Preset() if preset is None else named_preset(preset, env, steps)
    task, method, setting = build(env, ALGO if algo is None else algo, {**chosen.options, **options})
    return task, method, setting, chosen.seeds, chosen.schedule


def _refuse_changes(env: str | None, **given: Any) -> None:
    """Raise an InputError that names the task `env` or those arguments in `given` that are neither None nor empty."""
    changed = [f"--{name.replace('_', '-')}" for name, value in given.items() if value not in (None, ())]
    if env is not None or changed:
        named = ", ".join(changed) or f"the task {env!r}"
        raise InputError(f"--config repeats a run as it is: leave out {named}")


def _of_run(path: Path) -> tuple["Env", "Method", "Setting", tuple[int, ...], Schedule]:
    """Return the task, method, setting, seeds and schedule of the run at `path`; a ValueError without a valid config there."""
    from earl_jax.runs.contents import CONFIG
    from earl_jax.runs.folder import RunFolder, read_config, require_same_settings

    if not path.exists():
        raise InputError(f"--config takes a run folder or a config.json, and {path} does not exist")
    config = RunFolder.open(path).config if path.is_dir() else read_config(path)[0]
    require_same_settings(path / CONFIG if path.is_dir() else path)
    config.warn_of_changes(path)
    return config.build_env(), config.build_method(), config.build_setting(), config.seeds, config.schedule


def resume(
    folder: Positional[Path],
    steps: int | None = None,
    devices: int | None = None,
    hosts: str | None = None,
    minutes: str | None = None,
    json: bool = False,
) -> None:
    """Resume a run from its newest checkpoint. On a CPU the result is bit-identical to that of an uninterrupted run.

    Args:
        folder: Run folder.
        steps: New length of the run. By default the run keeps its length.
    """
    limit = parse_minutes(minutes)
    from earl_jax.runs.contents import VIDEOS
    from earl_jax.runs.folder import RunFolder
    from earl_jax.runs.hosts import failing_at_once, join_hosts
    from earl_jax.training import api

    join_hosts(hosts)
    with failing_at_once(), stopping(json, {"out": str(folder), "resume": resume_command(folder)}):
        logs = _video_logs(RunFolder.open(folder).recorded().get(VIDEOS))
        result = api.resume(folder, steps=steps, progress=True, devices=devices, minutes=limit, logs=logs)
    _emit_result(result, folder, json)


def _video_logs(count: int | None) -> list["VideoLog"]:
    """Return a list with the log that draws `count` videos; empty if there are none."""
    if count is None:
        return []
    from earl_jax.rendering import VideoLog

    return [VideoLog(count)]


def _emit_result(result: Any, out: Path, as_json: bool) -> None:
    """Print the score of `result`, if it has an evaluation, and after a time limit the command to continue it."""
    values, text = _score(result) if len(result.steps) else ({}, "no evaluation yet")
    values = {"out": str(out), "engine": result.engine, "steps": result.step, **values, "stopped": not result.finished}
    if not result.finished:
        values["resume"] = resume_command(out)
        text += f"\nstopped at step {result.step} of {result.config.steps}, the minutes have run out; "
        text += f"continue with: {values['resume']}"
    emit(values, as_json, f"{out}: {text}")


def _score(result: Any) -> tuple[dict[str, Any], str]:
    """Return the score of `result` as JSON values and as text, a line for each set of hyper-parameters of its seeds."""
    from earl_jax.metrics.continuing import DIVERGED, count_diverged
    from earl_jax.metrics.deployed import WIDE
    from earl_jax.report.runs import labelled, part_scores, parts

    score = result.score()
    values = {"score": score._asdict(), DIVERGED: count_diverged(result.metrics)}
    if WIDE in result.metrics:
        values[WIDE] = result.score(metric=WIDE)._asdict()
    own = parts(result)
    lines = labelled(own, [_score_text(part) for part in own])
    return values | part_scores(own), f"\n{result.folder.path}: ".join(lines)


def _score_text(curves: "Curves") -> str:
    """Return the score of `curves` in one line, with the score of wide starts and the number of diverged seeds."""
    from earl_jax.metrics.continuing import diverged_text
    from earl_jax.metrics.deployed import WIDE

    text = str(curves.score())
    if WIDE in curves.metrics:
        text += f"; {curves.score(WIDE).mean:.3f} from wide starts"
    return text + diverged_text(curves.diverged, curves.seeds)
