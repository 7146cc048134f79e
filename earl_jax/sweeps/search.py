"""A search for options: batches of runs are lanes of one program, scored at several lengths; the worse ones end early."""

import dataclasses
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from earl_jax.errors import InputError
from earl_jax.metrics.crossings import recent_scores
from earl_jax.options import TimeLimit
from earl_jax.runs.config import RunConfig
from earl_jax.runs.contents import CONFIG
from earl_jax.runs.files import locked, write_atomically
from earl_jax.runs.folder import RunFolder
from earl_jax.sweeps.grid import RunSpec, read_space
from earl_jax.sweeps.planner import planned_run
from earl_jax.sweeps.study import Trial, optuna, propose, to_prune
from earl_jax.sweeps.worker import work
from earl_jax.training.stopping import Stopped

TRIALS = "search.json"
"""The file of the trials in the folder of a search."""


class Plan(NamedTuple):
    """A search: its common run `base`, the distributions of its options, its lengths `rungs`, and what `identity` it has."""

    base: RunSpec
    distributions: dict[str, dict[str, Any]]
    rungs: tuple[int, ...]
    seed: int

    @property
    def identity(self) -> dict[str, Any]:
        """What a file of trials must have been made with, as JSON values."""
        values = {"run": dataclasses.asdict(self.base), "distributions": self.distributions}
        return json.loads(json.dumps({**values, "rungs": self.rungs, "seed": self.seed}))

    def run(self, options: dict[str, Any], steps: int) -> RunSpec:
        """Return the run with sampled `options`, `steps` long."""
        return dataclasses.replace(self.base, options={**self.base.options, **options}, steps=steps)


def search(
    space: Path,
    out: Path,
    trials: int = 32,
    batch: int = 8,
    rungs: int = 3,
    seed: int = 0,
    *,
    devices: int | None = None,
    emit: Callable[[str], None] = print,
    minutes: float | TimeLimit | None = None,
    progress: bool = True,
) -> list[Trial]:
    """Return the trials of a search for the options in `space` that score highest; the same call continues it.

    Args:
        space: a sweep file with one task, one method and options with distributions (docs/sweeps.md).
        out: the folder of the runs and of search.json, which has the trials.
        trials: the number of options to try.
        batch: the number of runs that train together, in one program where only floats differ.
        rungs: the number of lengths, equally spaced, at which runs are scored, and those below the median end; 1 prunes none.
        seed: seed of Optuna's sampler.
        devices: the number of devices that share the lanes.
        emit: receives a line for each result.
        minutes: a limit of wall-clock time from this call on; a call after that continues.
        progress: whether to show progress on stderr.

    Raises:
        ValueError: Optuna is not installed, the file or a number is invalid, or `out` has another search.
    """
    optuna()
    limit = TimeLimit.of(minutes)
    for name, number in (("trials", trials), ("batch", batch), ("rungs", rungs)):
        if number < 1:
            raise InputError(f"{name} must be at least 1, not {number}")
    base, distributions = read_space(space)
    plan = Plan(base, distributions, _lengths(base, rungs), seed)
    out.mkdir(parents=True, exist_ok=True)
    with locked(out):
        history = _read(out, plan)
        while any(trial.state == "running" for trial in history) or len(history) < trials:
            if not any(trial.state == "running" for trial in history):
                options = propose(history, distributions, min(batch, trials - len(history)), seed)
                history += [Trial(own, {}, "running") for own in options]
                _write(out, plan, history)
            if not _train_batch(plan, out, history, devices, emit, limit, progress):
                emit(f"{len(history)} of {trials} trials were begun; repeat the command to continue")
                break
    return history


def _lengths(base: RunSpec, rungs: int) -> tuple[int, ...]:
    """Return the steps of each rung, multiples of `eval_every` that end with the whole length."""
    every = base.eval_every
    lengths = sorted({max(every, round(base.steps * rung / rungs / every) * every) for rung in range(1, rungs)})
    return (*[steps for steps in lengths if steps < base.steps], base.steps)


def _train_batch(
    plan: Plan,
    out: Path,
    history: list[Trial],
    devices: int | None,
    emit: Callable[[str], None],
    limit: TimeLimit | None,
    progress: bool,
) -> bool:
    """Train the running trials of `history` through the rungs, and return whether that came to its end."""
    for steps in plan.rungs:
        current = [i for i, trial in enumerate(history) if trial.state == "running" and steps not in trial.scores]
        if not current:
            continue
        failed = _train(plan, out, [history[i] for i in current], steps, devices, limit, progress)
        for i in current:
            name = plan.run(history[i].options, steps).name
            score = _score(out / name, steps)
            if score is not None:
                history[i].scores[steps] = score
            elif name in failed:
                history[i] = history[i]._replace(state="failed")
                emit(f"failed     {name}  {failed[name]}")
            else:
                return False
        last = steps == plan.rungs[-1]
        pruned = set() if last else to_prune(history, current, steps)
        for i in (i for i in current if history[i].state == "running"):
            state = "done" if last else "pruned" if i in pruned else "running"
            history[i] = history[i]._replace(state=state)
            word = "continues" if state == "running" else state
            emit(f"{word:<10} {_text(history[i].options)}  {history[i].scores[steps]:.4g} at step {steps}")
        _write(out, plan, history)
    return True


def _train(
    plan: Plan,
    out: Path,
    trials: Sequence[Trial],
    steps: int,
    devices: int | None,
    limit: TimeLimit | None,
    progress: bool,
) -> dict[str, str]:
    """Train the runs of `trials` to `steps`, and return the causes of those that failed, by name."""
    configs: dict[str, RunConfig] = {}
    for spec in (plan.run(trial.options, steps) for trial in trials):
        path = out / spec.name
        if (path / CONFIG).is_file():
            folder = RunFolder.open(path)
            spec = dataclasses.replace(spec, steps=max(steps, folder.config.steps))
            if folder.config.steps < steps:
                folder.extended(steps)
        configs[spec.name] = planned_run(spec, out).run.config
    causes: dict[str, str] = {}

    def note(name: str, state: str, **details: Any) -> None:
        if state == "failed":
            causes[name] = details["why"]

    try:
        work(out, configs, note, progress, devices, limit=limit)
    except Stopped as stopped:
        stopped.args = (f"stopped at step {stopped.step}; repeat the command to continue",)
        raise
    return causes


def _score(path: Path, steps: int) -> float | None:
    """Return the mean over seeds of the recent deployed scores of the run at `path` at `steps`; None if it is not there."""
    if not (path / CONFIG).is_file():
        return None
    folder = RunFolder.open(path)
    reached, metrics = folder.config.curves([row for row in folder.rows() if row["step"] <= steps])
    if not len(reached) or reached[-1] < steps:
        return None
    return float(recent_scores(reached, metrics[folder.config.deployed_metric]).mean())


def _read(out: Path, plan: Plan) -> list[Trial]:
    """Return the trials in the folder `out`, none if it has no search yet."""
    path = out / TRIALS
    if not path.exists():
        return []
    try:
        values = json.loads(path.read_text())
        if values["search"] != plan.identity:
            raise InputError(
                f"{path} is of a search with other values; choose another --out, or the file, rungs and seed it had"
            )
        return [
            Trial(trial["options"], {int(step): score for step, score in trial["scores"].items()}, trial["state"])
            for trial in values["trials"]
        ]
    except (KeyError, TypeError, AttributeError, json.JSONDecodeError) as error:
        raise InputError(
            f"{path} is damaged: {error!r}; restore it, or delete it to start again from the runs"
        ) from error


def _write(out: Path, plan: Plan, history: Sequence[Trial]) -> None:
    values = {"search": plan.identity, "trials": [trial._asdict() for trial in history]}
    write_atomically(out / TRIALS, json.dumps(values, indent=2) + "\n")


def _text(options: dict[str, Any]) -> str:
    return ", ".join(f"{name}={value}" for name, value in sorted(options.items()))


def best_trial(history: Sequence[Trial]) -> Trial | None:
    """Return the finished trial with the highest score, or None if there is none."""
    return max((trial for trial in history if trial.state == "done"), key=lambda trial: trial.last, default=None)
