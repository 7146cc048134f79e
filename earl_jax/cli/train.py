"""Commands that train: train, resume, sweep, reproduce, quickstart."""

from pathlib import Path
from typing import Any, Literal

from earl_jax.cli.arguments import (
    JSON,
    Devices,
    Hosts,
    Logs,
    Physics,
    Positional,
    Set,
    Slurm,
    options_of,
    say,
    say_line,
)


def train(
    env: Positional[str],
    algo: str = "fbrl",
    seeds: int = 5,
    steps: int = 100_000,
    out: Path = Path("runs/latest"),
    eval_every: int = 10_000,
    eval_episodes: int = 10,
    checkpoint_every: int = 100_000,
    setting: Literal["deployment", "continuing"] = "deployment",
    physics: Physics = None,
    devices: Devices = None,
    hosts: Hosts = None,
    log: Logs = (),
    set: Set = (),
    json: JSON = False,
) -> None:
    """Train a method on a task without resets, all seeds in one program.

    Args:
        env: the task, a name of `earl-jax list`.
        algo: the method, a name of `earl-jax list`.
        seeds: how many seeds, 0 upwards.
        steps: training steps of each seed.
        out: a new folder for config.json, metrics.csv and checkpoints.
        eval_every: steps between evaluations.
        eval_episodes: greedy episodes of each deployed evaluation.
        checkpoint_every: steps between checkpoints.
        setting: what the life is for; docs/formalism.md has the options of both, for --set.
    """
    from earl_jax import algos, envs, training
    from earl_jax.runs.hosts import join_hosts

    join_hosts(hosts)
    task, chosen, options = training.split_options(env, {"setting": setting, **options_of(set)})
    task = envs.with_physics(task, physics)
    result = training.train(
        task, algos.method_for(task, algo, **options), setting=chosen, seeds=seeds, steps=steps, out=out,
        eval_every=eval_every, eval_episodes=eval_episodes, checkpoint_every=checkpoint_every, logs=log, progress=True,
        devices=devices,
    )  # fmt: skip
    _report_run(result, out, json)


def resume(
    folder: Positional[Path], steps: int | None = None, devices: Devices = None, hosts: Hosts = None, json: JSON = False
) -> None:
    """Go on with a run from its newest checkpoint; the end is bit-identical to that of a run never stopped.

    Args:
        folder: a run folder.
        steps: make the run this long instead of what it was started with.
    """
    from earl_jax.runs.hosts import join_hosts
    from earl_jax.training import resume as resume_run

    join_hosts(hosts)
    result = resume_run(folder, steps=steps, progress=True, devices=devices)
    _report_run(result, folder, json)


def sweep(
    grid: Positional[Path],
    out: Path = Path("runs/sweep"),
    launcher: Literal["local", "slurm"] = "local",
    max_lanes: int | None = None,
    slurm: Slurm = (),
    devices: Devices = None,
    log: Logs = (),
    dry_run: bool = False,
    json: JSON = False,
) -> None:
    """Train every cell of a grid, as many of them in one program as fit it; the same command goes on after a kill.

    Args:
        grid: a TOML file of tasks, methods and options (docs/sweeps.md).
        out: the folder of the run folders, DIR/<task>/<method>/<options>.
        launcher: local, one program after another on this machine; slurm, an array job through submitit.
        max_lanes: lanes (cells x seeds) of the largest program.
        dry_run: print the programs with their lanes, folders and memory, and start nothing.
    """
    from earl_jax.sweeps import launcher as launching

    if dry_run:
        plan = launching.planned(grid, out, max_lanes)
        say(plan, json, launching.described(plan))
        return
    lines: list[str] = []
    failed = launching.sweep(grid, out, launcher, max_lanes, slurm, devices, lines.append if json else say_line, log)
    if json:
        say({"out": str(out), "failed": failed, "lines": lines}, json, "")
    if failed:
        raise SystemExit(1)


def reproduce(
    name: Positional[Literal["table1", "table2", "curves", "figure2", "figure4", "figure5"]],
    scale: Literal["smoke", "short", "full"] = "smoke",
    out: Path | None = None,
    tasks: tuple[str, ...] = (),
    seeds: int | None = None,
    steps: int | None = None,
    max_lanes: int | None = None,
    devices: Devices = None,
    set: Set = (),
) -> None:
    """Train and draw a table or figure of the paper beside the published one; the same command goes on after a kill.

    Args:
        name: the table or figure.
        scale: smoke, one task for some hundred steps; short, a tenth of the published steps; full, all of them.
        out: one folder for the runs and results of all of them; runs/reproduce-SCALE by default.
        tasks: only these tasks.
        seeds: another number of seeds than the scale's (2, 3, 5).
        steps: another length than the scale's.
        max_lanes: lanes of the largest program.
    """
    from earl_jax.paper import reproduce as paper

    options = options_of(set)
    for path in paper.reproduce(name, scale, out, tasks, seeds, steps, options, max_lanes, devices, say_line):
        print(path)


def quickstart(out: Path = Path("runs/quickstart"), steps: int | None = None) -> None:
    """Watch forward-backward RL learn tabletop organization on a CPU within minutes.

    Args:
        out: a new folder for the run, curves.png and table.md.
        steps: training steps of each seed instead of the preset's.
    """
    from earl_jax.cli import quickstart as preset

    preset.quickstart(out, steps or preset.STEPS)


def _report_run(result: Any, out: Path, as_json: bool) -> None:
    from earl_jax.metrics.statistics import summarise
    from earl_jax.runs.config import deployed_metric

    metric = deployed_metric(result.env)
    final = summarise(result.metrics[metric][:, -1])
    answer = {"out": str(out), "steps": int(result.steps[-1]), metric: final._asdict()}
    text = f"{out}: {metric} {final.mean:.3f} (stderr {final.stderr:.3f}) over {final.seeds} seeds"
    say(answer, as_json, text)
