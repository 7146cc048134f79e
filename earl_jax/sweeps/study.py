"""What Optuna does in a search: it proposes options from the scores so far, and says which runs to stop.

A study is made anew from the trials each time, so that the file of the trials is all that a search remembers, and a search
that was killed proposes what it would have proposed.
"""

import importlib
import json
from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple

from earl_jax.errors import InputError
from earl_jax.sweeps.samples import mapping, rounded

State = Literal["running", "done", "pruned", "failed"]


class Trial(NamedTuple):
    """The sampled `options` of a run, its mean `scores` by step, and its `state`."""

    options: dict[str, Any]
    scores: dict[int, float]
    state: State

    @property
    def last(self) -> float:
        """The score at its last step."""
        return self.scores[max(self.scores)]


def optuna() -> Any:
    """Return the module of Optuna, whose log is silent.

    Raises:
        ValueError: it is not installed.
    """
    try:
        module: Any = importlib.import_module("optuna")
    except ImportError as error:
        raise InputError("search needs optuna: pip install 'earl-jax[search]'") from error
    module.logging.set_verbosity(module.logging.ERROR)
    return module


def propose(
    trials: Sequence[Trial], distributions: Mapping[str, dict[str, Any]], count: int, seed: int
) -> list[dict[str, Any]]:
    """Return `count` options to try next, by Optuna's TPE: random ones at first.

    The options of one batch keep apart from each other (`constant_liar`). The result depends on the arguments alone.
    """
    module = optuna()
    sampler = module.samplers.TPESampler(seed=seed + len(trials), constant_liar=True)
    study = module.create_study(direction="maximize", sampler=sampler)
    spaces = {name: _space(module, name, distribution) for name, distribution in sorted(distributions.items())}
    study.add_trials([_frozen(module, trial, spaces) for trial in trials])
    asked = [study.ask(spaces).params for _ in range(count)]
    return [{name: _plain(distributions[name], value) for name, value in params.items()} for params in asked]


def to_prune(trials: Sequence[Trial], current: Sequence[int], step: int) -> set[int]:
    """Return those of the `current` trials, numbers in `trials`, that score below the median at `step`.

    The median is over all trials that have a score there, so that trials of one batch compete with each other too.
    """
    module = optuna()
    known = [trial for trial in trials if step in trial.scores]
    study = module.create_study(direction="maximize")
    peers = [trial._replace(state="done", scores={step: trial.scores[step]}) for trial in known]
    study.add_trials([_frozen(module, peer, {}) for peer in peers])
    pruner = module.pruners.MedianPruner(n_startup_trials=2, n_warmup_steps=0)
    return {
        number
        for number in current
        if step in trials[number].scores
        and pruner.prune(study, _frozen(module, Trial({}, {step: trials[number].scores[step]}, "running"), {}))
    }


def _frozen(module: Any, trial: Trial, spaces: Mapping[str, Any]) -> Any:
    """Return `trial` as Optuna has it."""
    states = module.trial.TrialState
    state = {"running": states.RUNNING, "done": states.COMPLETE, "pruned": states.PRUNED, "failed": states.FAIL}[
        trial.state
    ]
    params = {
        name: json.dumps(trial.options[name])
        if isinstance(space, module.distributions.CategoricalDistribution)
        else value
        for name, space in spaces.items()
        for value in [trial.options[name]]
    }
    return module.trial.create_trial(
        state=state,
        value=trial.last if trial.state in ("done", "pruned") else None,
        params=params,
        distributions=dict(spaces),
        intermediate_values=trial.scores,
    )


def _space(module: Any, option: str, distribution: dict[str, Any]) -> Any:
    """Return a distribution of a sweep file as Optuna has it; choices are JSON texts, because lists are none for it."""
    mapping(option, distribution)  # it checks it
    [(kind, ends)] = distribution.items()
    spaces = module.distributions
    if kind == "choice":
        return spaces.CategoricalDistribution([json.dumps(value) for value in ends])
    if kind == "integers":
        return spaces.IntDistribution(*ends)
    return spaces.FloatDistribution(*map(float, ends), log=kind == "log_uniform")


def _plain(distribution: dict[str, Any], value: Any) -> Any:
    """Return the value of an option that Optuna has proposed, a float with as many digits as samples have."""
    [(kind, ends)] = distribution.items()
    if kind == "choice":
        return json.loads(value)
    return int(value) if kind == "integers" else rounded(value, *map(float, ends))
