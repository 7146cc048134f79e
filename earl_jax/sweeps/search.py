"""A search for options on Optuna: batches of runs are lanes of one program, scored at several lengths; the worse ones end early.

Optuna's journal holds all that a search remembers. Samplers are made anew for every trial, so that a search that was killed
proposes what it would have proposed.
"""

import dataclasses
import importlib
import json
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from earl_jax.errors import InputError
from earl_jax.metrics.crossings import recent_scores
from earl_jax.options import TimeLimit
from earl_jax.runs.config import RunConfig
from earl_jax.runs.contents import CONFIG
from earl_jax.runs.files import locked
from earl_jax.runs.folder import RunFolder
from earl_jax.sweeps.grid import RunSpec, read_space
from earl_jax.sweeps.planner import planned_run
from earl_jax.sweeps.worker import work
from earl_jax.training.stopping import Stopped

TRIALS = "search.journal"
"""Optuna's file of the trials in the folder of a search."""
STATES = {"RUNNING": "running", "COMPLETE": "done", "PRUNED": "pruned", "FAIL": "failed"}


class Trial(NamedTuple):
    """The sampled `options` of a run, its mean `scores` by step, and its `state`: running, done, pruned or failed."""

    options: dict[str, Any]
    scores: dict[int, float]
    state: str


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
        rungs: the number of lengths, equally spaced, at which runs are scored, and those below the median end; 1 prunes none.
        seed: seed of Optuna's sampler.
        devices, emit, minutes: as those of `launcher.sweep`.

    Raises:
        ValueError: Optuna is not installed, the file or a number is invalid, or `out` has another search.
    """
    for name, number, least in (("trials", trials, 1), ("batch", batch, 1), ("rungs", rungs, 1), ("seed", seed, 0)):
        if number < least:
            raise InputError(f"{name} must be at least {least}, not {number}")
    base, distributions, sampler = read_space(space)
    spaces = {name: _space(distribution) for name, distribution in sorted(distributions.items())}
    lengths = _lengths(base, rungs)
    identity = json.loads(json.dumps([dataclasses.asdict(base), distributions, sampler, lengths, seed]))
    limit = TimeLimit.of(minutes)
    out.mkdir(parents=True, exist_ok=True)
    with locked(out):
        state = Search(base, spaces, out, lengths, _open_study(out / TRIALS, identity), emit, devices, limit)
        ended = state.train_batch()  # which an earlier call began
        while ended and len(state.history()) < trials:
            state.ask(min(batch, trials - len(state.history())), sampler, seed)
            ended = state.train_batch()
        if not ended:
            emit(f"{len(state.history())} of {trials} trials were begun; repeat the command to continue")
        return state.history()


@dataclasses.dataclass(frozen=True)
class Search:
    """A search in the folder `out`: its common run `base`, Optuna's `spaces` of the options, its `lengths` and its study."""

    base: RunSpec
    spaces: dict[str, Any]
    out: Path
    lengths: tuple[int, ...]
    study: Any
    emit: Callable[[str], None]
    devices: int | None
    limit: TimeLimit | None

    def history(self) -> list[Trial]:
        """Return all trials so far."""
        trials = []
        for trial in self.study.get_trials(deepcopy=False):
            options = {name: _plain(self.spaces[name], value) for name, value in trial.params.items()}
            trials.append(Trial(options, dict(trial.intermediate_values), STATES[trial.state.name]))
        return trials

    def ask(self, count: int, sampler: str, seed: int) -> None:
        """Add `count` trials. They depend on the trials so far and the seed alone."""
        samplers, begun = optuna().samplers, len(self.history())
        for number in range(begun, begun + count):
            if sampler == "qmc":
                self.study.sampler = samplers.QMCSampler(seed=seed, scramble=True)
            elif sampler == "random":
                self.study.sampler = samplers.RandomSampler(seed=seed + number)
            else:  # the liar keeps the trials of a batch apart
                self.study.sampler = samplers.TPESampler(seed=seed + number, constant_liar=True)
            self.study.ask(self.spaces)

    def train_batch(self) -> bool:
        """Train the running trials through all lengths, and return whether that came to its end."""
        for steps in self.lengths:
            specs = {
                i: dataclasses.replace(self.base, options={**self.base.options, **trial.options}, steps=steps)
                for i, trial in enumerate(self.history())
                if trial.state == "running" and max(trial.scores, default=0) < steps
            }
            causes = self._train(list(specs.values()), steps) if specs else {}
            for i, spec in specs.items():
                score = _score(self.out / spec.name, steps)
                if score is not None:
                    frozen = self.study.get_trials(deepcopy=False)[i]
                    self.study._storage.set_trial_intermediate_value(frozen._trial_id, steps, score)
                elif spec.name in causes:
                    self.study.tell(i, state=optuna().trial.TrialState.FAIL)
                    self.emit(f"failed     {spec.name}  {causes[spec.name]}")
                else:
                    return False
            self._conclude(steps)
        return True

    def _train(self, specs: Sequence[RunSpec], steps: int) -> dict[str, str]:
        """Train the runs `specs` to `steps`, and return the causes of those that failed, by name."""
        configs: dict[str, RunConfig] = {}
        for spec in specs:
            path, length = self.out / spec.name, steps
            if (path / CONFIG).is_file():
                length = max(steps, RunFolder.open(path).config.steps)  # an equal trial may be longer
                RunFolder.open(path).extended(length)
            configs[spec.name] = planned_run(dataclasses.replace(spec, steps=length), self.out).run.config
        causes: dict[str, str] = {}

        def note(name: str, state: str, **details: Any) -> None:
            if state == "failed":
                causes[name] = details["why"]

        try:
            work(self.out, configs, note, devices=self.devices, limit=self.limit)
        except Stopped as stopped:
            stopped.args = (f"stopped at step {stopped.step}; repeat the command to continue",)
            raise
        return causes

    def _conclude(self, steps: int) -> None:
        """End the trials that have reached the last length; at another one, prune those that score below the median."""
        history = self.history()
        scores = [trial.scores[steps] for trial in history if steps in trial.scores]
        for i, trial in enumerate(history):
            if trial.state != "running" or max(trial.scores) != steps:
                continue
            score, state = trial.scores[steps], "continues"
            if steps == self.lengths[-1]:
                state = "done"
                self.study.tell(i, score)
            elif below_median(score, scores):
                state = "pruned"
                self.study.tell(i, state=optuna().trial.TrialState.PRUNED)
            options = ", ".join(f"{name}={value}" for name, value in trial.options.items())
            self.emit(f"{state:<10} {options}  {score:.4g} at step {steps}")


def below_median(score: float, scores: Sequence[float]) -> bool:
    """Return whether Optuna's median pruner ends a run with this score among the `scores` of all runs of this length."""
    module = optuna()
    study, make = module.create_study(direction="maximize"), module.trial.create_trial
    study.add_trials([make(value=other, intermediate_values={1: other}) for other in scores])
    trial = make(state=module.trial.TrialState.RUNNING, intermediate_values={1: score})
    return module.pruners.MedianPruner(n_startup_trials=2).prune(study, trial)


def _lengths(base: RunSpec, rungs: int) -> tuple[int, ...]:
    """Return the steps of each rung, multiples of `eval_every` that end with the whole length."""
    every = base.eval_every
    lengths = {max(every, round(base.steps * rung / rungs / every) * every) for rung in range(1, rungs)}
    return (*sorted(steps for steps in lengths if steps < base.steps), base.steps)


def _score(path: Path, steps: int) -> float | None:
    """Return the mean over seeds of the recent deployed scores of the run at `path` at `steps`; None if it is not there."""
    if not (path / CONFIG).is_file():
        return None
    folder = RunFolder.open(path)
    reached, metrics = folder.config.curves([row for row in folder.rows() if row["step"] <= steps])
    if not len(reached) or reached[-1] < steps:
        return None
    return float(recent_scores(reached, metrics[folder.config.deployed_metric]).mean())


def _space(distribution: dict[str, Any]) -> Any:
    """Return Optuna's distribution of an option; choices are JSON texts, because Optuna has no lists."""
    spaces, [(kind, ends)] = optuna().distributions, distribution.items()
    if kind == "choice":
        return spaces.CategoricalDistribution([json.dumps(value) for value in ends])
    if kind == "integers":
        return spaces.IntDistribution(*ends)
    return spaces.FloatDistribution(*map(float, ends), log=kind == "log_uniform")


def _plain(space: Any, value: Any) -> Any:
    """Return an option as Optuna proposed it, a float with four significant digits: the run's name has the exact value."""
    if isinstance(value, float):
        return min(max(float(f"{value:.4g}"), space.low), space.high)
    return json.loads(value) if isinstance(value, str) else value


def _open_study(path: Path, identity: dict[str, Any]) -> Any:
    """Return the study in the journal at `path`, which is created if necessary; `identity` is what it must have begun with."""
    module = optuna()
    if path.is_symlink():
        raise InputError(f"{path} is a link, and a search writes through none; remove it")
    path.with_name(f"{TRIALS}.lock").unlink(missing_ok=True)  # a kill leaves it; the folder has its own lock
    try:
        storage = module.storages.JournalStorage(module.storages.journal.JournalFileBackend(str(path)))
        study = module.create_study(storage=storage, study_name="search", direction="maximize", load_if_exists=True)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{path} is damaged: {error!r}; restore it, or delete it to start again") from error
    if study.user_attrs.setdefault("search", identity) != identity:
        raise InputError(f"{path} is of a search with other values; choose another --out, or the values that it had")
    study.set_user_attr("search", identity)
    return study


def optuna() -> Any:
    """Return the module of Optuna with a silent log; an InputError names the extra that installs it."""
    try:
        module: Any = importlib.import_module("optuna")
    except ImportError as error:
        raise InputError("search needs optuna: pip install 'earl-jax[search]'") from error
    module.logging.set_verbosity(module.logging.ERROR)
    warnings.filterwarnings("ignore", category=module.exceptions.ExperimentalWarning)
    return module
