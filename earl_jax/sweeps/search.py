"""A search for options with Optuna: runs are lanes of one program and are scored at several steps; bad ones end early.

Optuna's journal holds all that a search remembers. Samplers are made anew for every trial, so that a search that was killed
proposes what it would have proposed.
"""

import dataclasses
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from earl_jax.errors import InputError
from earl_jax.metrics.scores import final_scores
from earl_jax.options.schedule import Schedule
from earl_jax.options.values import COUNT, COUNT_OR_NEVER, TimeLimit, require
from earl_jax.runs.config import RunConfig
from earl_jax.runs.contents import is_run
from earl_jax.runs.files import check_folder, check_kind, locked
from earl_jax.runs.folder import RunFolder
from earl_jax.sweeps import grid
from earl_jax.sweeps.space import check_ends, option, optuna, read_space
from earl_jax.sweeps.worker import planned_run, require_same, work
from earl_jax.training.devices import lane_mesh
from earl_jax.training.stopping import Stopped

TRIALS = "search.journal"
"""Optuna's file of the trials in the folder of a search."""
STATES = {"RUNNING": "running", "COMPLETE": "done", "PRUNED": "pruned", "FAIL": "failed"}


class Trial(NamedTuple):
    """The sampled `options` of a run, its mean `scores` by step, its `state`: running, done, pruned or failed, and its `name`.

    That is its folder in the one of the search.
    """

    options: dict[str, Any]
    scores: dict[int, float]
    state: str
    name: str


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
) -> list[Trial]:
    """Return the trials of a search for the options in `space` that score highest; the same call continues it.

    Args:
        space: a sweep file with one task, one method and options with distributions (docs/sweeps.md).
        out: the folder of the runs and of search.journal, which has the trials.
        trials: the number of options to try.
        batch: the number of runs that train together, in one program where only floats differ.
        rungs: the number of steps, equally spaced, at which runs are scored, and those below the median end; 1 prunes none.
        seed: seed of Optuna's sampler.
        devices, emit, minutes: as those of `launcher.sweep`.

    Raises:
        ValueError: Optuna is not installed, the file or a number is invalid, the devices are too few or the seeds do
            not divide over them, or `out` is not a local folder or holds another search.
    """
    for name, number in {"trials": trials, "batch": batch, "rungs": rungs}.items():
        require(name, number, COUNT)
    require("seed", seed, COUNT_OR_NEVER)  # the number of a trial is added, and the sum is a seed of NumPy
    optuna()
    base, spaces, sampler = read_space(space)
    check_ends(base, spaces)
    lane_mesh(devices, len(base.seeds))  # those of a single trial, because programs lose trials at every rung
    rung_steps = _rung_steps(base.schedule, rungs)
    limit = TimeLimit.of(minutes)
    check_folder(out)
    out.mkdir(parents=True, exist_ok=True)
    with locked(out):
        values = _values(base, spaces) | {"sampler": repr(sampler), "rungs": repr(rung_steps), "seed": repr(seed)}
        study, storage = _open_study(out / TRIALS, values)
        state = Search(base, spaces, out, rung_steps, study, storage, emit, devices, limit)
        while (ended := state.train_batch()) and len(study.trials) < trials:  # first what an earlier call began
            for number in range(len(study.trials), min(len(study.trials) + batch, trials)):
                study.sampler = _sampler(sampler, seed, number)
                study.ask(spaces)
        if not ended:
            emit(f"{len(study.trials)} of {trials} trials were begun; repeat the command to continue")
        return state.history()


@dataclasses.dataclass(frozen=True)
class Search:
    """A search in the folder `out`: its common run `base`, Optuna's `spaces`, its `rung_steps`, and its study in a `storage`."""

    base: grid.RunSpec
    spaces: dict[str, Any]
    out: Path
    rung_steps: tuple[int, ...]
    study: Any
    storage: Any
    emit: Callable[[str], None]
    devices: int | None
    limit: TimeLimit | None

    def history(self) -> list[Trial]:
        """Return all trials so far."""
        return [
            Trial(own, trial.intermediate_values, STATES[trial.state.name], self._spec(own).name)
            for trial in self.study.trials
            for own in [self._options(trial)]
        ]

    def _spec(self, own: dict[str, Any]) -> grid.RunSpec:
        return dataclasses.replace(self.base, options={**self.base.options, **own})

    def _options(self, trial: Any) -> dict[str, Any]:
        return {name: option(self.spaces[name], value) for name, value in trial.params.items()}

    def _running(self) -> list[Any]:
        return [trial for trial in self.study.trials if not trial.state.is_finished()]

    def train_batch(self) -> bool:
        """Train the running trials through all rungs, and return whether that came to its end."""
        for steps in self.rung_steps:
            schedule = self.base.schedule.changed(steps=steps)
            trials = [trial for trial in self._running() if steps not in trial.intermediate_values]
            specs = [dataclasses.replace(self._spec(self._options(trial)), schedule=schedule) for trial in trials]
            if specs:
                self._train(specs)
            for trial, spec in zip(trials, specs, strict=True):
                score = _score(self.out / spec.name, steps)
                if score is not None:  # Optuna's own `report` works only in the process that asked for the trial
                    study = self.storage.get_study_id_from_name(self.study.study_name)
                    own = self.storage.get_trial_id_from_study_id_trial_number(study, trial.number)
                    self.storage.set_trial_intermediate_value(own, steps, score)
                elif self.limit and self.limit.passed:
                    return False
                else:
                    self.study.tell(trial.number, state=optuna().trial.TrialState.FAIL)
            self._conclude(steps)
        return True

    def _train(self, specs: Sequence[grid.RunSpec]) -> None:
        """Train the runs `specs` to their steps, and emit the causes of those that fail."""
        configs: dict[str, RunConfig] = {}
        for spec in specs:
            path = self.out / spec.name
            if is_run(path):  # an equal trial may be longer
                steps = max(spec.schedule.steps, RunFolder.open(path).config.steps)
                spec = dataclasses.replace(spec, schedule=spec.schedule.changed(steps=steps))
            configs[spec.name] = planned_run(spec, self.out).run.config

        def report(name: str, state: str, detail: str) -> None:
            if state == "failed":
                self.emit(f"failed     {name}  {detail}")

        try:
            work(self.out, configs, report, devices=self.devices, limit=self.limit)
        except Stopped as stopped:
            stopped.args = (f"stopped at step {stopped.step}; repeat the command to continue",)
            raise

    def _conclude(self, steps: int) -> None:
        """End the trials that have reached the last rung; at another one, prune those that score below the median. A nan fails.

        It is the median of all trials at this rung. That of Optuna's pruner is of finished trials, so a first batch
        would not be pruned.
        """
        scores = [trial.intermediate_values.get(steps, math.nan) for trial in self.study.trials]
        for trial in self._running():
            if trial.last_step != steps:
                continue
            score, state = trial.intermediate_values[steps], "continues"
            if math.isnan(score):
                state = "failed"
                self.study.tell(trial.number, state=optuna().trial.TrialState.FAIL)
            elif steps == self.rung_steps[-1]:
                state = "done"
                self.study.tell(trial.number, score)
            elif score < np.nanmedian(scores):
                state = "pruned"
                self.study.tell(trial.number, state=optuna().trial.TrialState.PRUNED)
            options = ", ".join(f"{name}={value}" for name, value in self._options(trial).items())
            self.emit(f"{state:<10} {options}  score {score:.4g} at step {steps}")


def _sampler(name: str, seed: int, number: int) -> Any:
    """Return Optuna's sampler for the trial `number`."""
    samplers = optuna().samplers
    if name == "qmc":
        return samplers.QMCSampler(seed=seed, scramble=True)
    if name == "random":
        return samplers.RandomSampler(seed=seed + number)
    return samplers.TPESampler(seed=seed + number, constant_liar=True)  # the liar keeps the trials of a batch apart


def _rung_steps(schedule: Schedule, rungs: int) -> tuple[int, ...]:
    """Return the steps of each rung, multiples of `eval_every`, up to those of the `schedule`."""
    every, steps, rungs = schedule.eval_every, schedule.steps, min(rungs, schedule.steps // schedule.eval_every)
    below = {max(every, round(steps * rung / rungs / every) * every) for rung in range(1, rungs)}
    return (*sorted(rung for rung in below if rung < steps), steps)


def _score(path: Path, steps: int) -> float | None:
    """Return the mean over seeds of the deployed scores of the run at `path` at `steps`; None if it is not there."""
    if not is_run(path):
        return None
    folder = RunFolder.open(path)
    table = folder.table().until(steps)
    if table.step < steps:
        return None
    return float(final_scores(table.steps, table.metrics[folder.config.deployed_metric]).mean())


def _values(base: grid.RunSpec, spaces: dict[str, Any]) -> dict[str, str]:
    """Return the values of a space file by name, as texts."""
    values = dataclasses.asdict(base.schedule) | {"env": base.env, "algo": base.algo, "seeds": base.seeds}
    values |= {f"options.{name}": value for name, value in {**base.options, **spaces}.items()}
    return {name: repr(value) for name, value in values.items()}


def _open_study(path: Path, values: dict[str, str]) -> tuple[Any, Any]:
    """Return the study in the journal at `path`, created if necessary, and its storage; it must have begun with `values`."""
    module = optuna()
    check_kind(path)
    path.with_name(f"{TRIALS}.lock").unlink(missing_ok=True)  # a kill leaves it; the folder has its own lock
    try:
        storage = module.storages.JournalStorage(module.storages.journal.JournalFileBackend(str(path)))
        study = module.create_study(storage=storage, study_name="search", direction="maximize", load_if_exists=True)
        begun = study.user_attrs.get("search", values)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        cause = f"{type(error).__name__}: {error}"  # the repr of an error of UTF-8 holds the whole file
        raise InputError(f"{path} is damaged: {cause}; restore it, or delete it to start again") from error
    if not isinstance(begun, dict):
        raise InputError(f"{path} was begun by another version of earl_jax; choose another --out")
    require_same(f"{path} is of a search", begun, values)
    study.set_user_attr("search", values)
    return study, storage
