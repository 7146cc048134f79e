"""Commands that train many runs: sweep, search, reproduce."""

import itertools
from pathlib import Path
from shlex import quote
from typing import Literal

from earl_jax.cli.arguments import Logs, Positional, Texts, emit, parse_minutes, parse_options, stopping
from earl_jax.sweeps.slots import PerDevice


def sweep(
    grid: Positional[Path],
    out: Path = Path("runs/sweep"),
    launcher: Literal["local", "slurm"] = "local",
    max_lanes: int | None = None,
    slurm: Texts = (),
    devices: int | None = None,
    per_device: PerDevice = None,
    minutes: str | None = None,
    log: Logs = (),
    dry_run: bool = False,
    json: bool = False,
) -> None:
    """Train every run of a grid; runs that fit into one program share it. After a kill, repeat the command to continue.

    Args:
        grid: TOML file of tasks, methods and options (docs/sweeps.md).
        out: Parent folder of the run folders, OUT/<task>/<method>/<options>.
        launcher: local runs the programs on this machine; slurm submits an array job.
        slurm: Options of sbatch as name=value pairs: time (minutes), partition, ... By default none.
        dry_run: Print the programs with their lanes, folders and memory, and start nothing.
    """
    limit = parse_minutes(minutes)
    from earl_jax.sweeps import launcher as launchers

    pairs, logs = tuple(itertools.chain(*slurm)), tuple(itertools.chain(*log))
    if dry_run:
        launchers.check_options(launcher, pairs, devices, per_device, limit)
        plan = launchers.plan_sweep(grid, out, max_lanes, logs)
        emit(plan, json, launchers.describe(plan))
        return
    lines: list[str] = []
    try:
        outcome = launchers.sweep(
            grid,
            out,
            launcher,
            max_lanes=max_lanes,
            slurm=pairs,
            devices=devices,
            per_device=per_device,
            emit=lines.append if json else print,
            logs=logs,
            minutes=limit,
        )
    except launchers.Stopped as stopped:
        outcome, code = stopped.outcome, stopped.code
    else:
        code = 1 if outcome.failed else None
    if json:
        runs = [{"folder": str(out / name), **run} for name, run in outcome.runs.items()]
        values = {"out": str(out), "failed": len(outcome.failed), "runs": runs, "lines": lines}
        values["stopped"] = bool(outcome.unfinished)
        if outcome.unfinished:
            values |= {"unfinished": outcome.unfinished, "resume": "repeat the command"}
        emit(values, json, "")
    if code:
        raise SystemExit(code)


def search(
    space: Positional[Path],
    out: Path = Path("runs/search"),
    trials: int = 32,
    batch: int = 8,
    rungs: int = 3,
    seed: int = 0,
    devices: int | None = None,
    minutes: str | None = None,
    json: bool = False,
) -> None:
    """Search for the options that score highest, with Optuna, in batches of runs. After a kill, repeat the command.

    Args:
        space: Sweep file of one task and one method, in which options have distributions (docs/sweeps.md).
        out: Folder for the runs and for search.journal, which records all trials.
        trials: Number of combinations of options to try.
        batch: Number of runs that train together, as lanes of one program if they differ only in floats.
        rungs: Number of times at which runs are scored; those below the median end there. 1 lets all runs finish.
        seed: Random seed of the options; the file gives the seeds of training.
    """
    limit = parse_minutes(minutes)
    from earl_jax.sweeps.search import STATES, TRIALS, search as run_search

    lines: list[str] = []
    report = lines.append if json else print
    with stopping(json, {"out": str(out), "lines": lines, "resume": "repeat the command"}):
        history = run_search(space, out, trials, batch, rungs, seed, devices=devices, emit=report, minutes=limit)
    done = [trial for trial in history if trial.state == "done"]
    best = max(done, key=lambda trial: trial.scores[max(trial.scores)], default=None)
    counts = {state: sum(trial.state == state for trial in history) for state in STATES.values()}
    text = ", ".join(f"{count} {state}" for state, count in counts.items() if count)
    if best:
        text += f"; best {best.scores[max(best.scores)]:.4g} with {best.options}"
    values = {"out": str(out), **counts, "lines": lines, "trials": [trial._asdict() for trial in history]}
    values |= {"best": best._asdict() if best else None, "stopped": counts["running"] > 0 or len(history) < trials}
    emit(values, json, f"{out / TRIALS}: {text}\nrank them with intervals and tests: earl-jax best {quote(str(out))}")
    if counts["failed"] == len(history):
        raise SystemExit(1)


def reproduce(
    name: Positional[Literal["table1", "table2", "figure2", "figure3", "figure4", "figure5", "tradeoff"]],
    scale: Literal["smoke", "short", "full"] = "smoke",
    out: Path | None = None,
    tasks: tuple[str, ...] = (),
    seeds: int | None = None,
    steps: int | None = None,
    max_lanes: int | None = None,
    devices: int | None = None,
    per_device: PerDevice = None,
    minutes: str | None = None,
    set: Texts = (),
) -> None:
    """Train and draw a table or figure of the paper beside the published one. After a kill, repeat the command to continue.

    Args:
        name: Table or figure, or the trade-off of learning against interventions that the conclusion names.
        scale: smoke trains one task for 120 steps, short a tenth of the published steps, full all of them.
        out: Folder that all tables and figures share for runs and results. By default runs/reproduce-SCALE.
        tasks: Tasks to include. By default those of the scale.
        seeds: Number of seeds. By default the scale's 2, 3 or 5.
        steps: Training steps of each seed. By default those of the scale.
    """
    limit = parse_minutes(minutes)
    from earl_jax.paper import reproduce as paper

    paths, failed = paper.reproduce(
        name,
        scale,
        out,
        tasks=tasks,
        seeds=seeds,
        steps=steps,
        options=parse_options(itertools.chain(*set)),
        max_lanes=max_lanes,
        devices=devices,
        per_device=per_device,
        minutes=limit,
    )
    for path in paths:
        print(path)
    if failed:
        print(f"failed runs: {', '.join(failed)}")
        raise SystemExit(1)
