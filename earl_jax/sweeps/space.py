"""The space of a search: the run of its file, and the distributions of the options that Optuna draws."""

import dataclasses
import itertools
import json
import math
import operator
import warnings
from pathlib import Path
from typing import Any

from earl_jax.errors import InputError, optional, require_known
from earl_jax.sweeps import grid
from earl_jax.sweeps.worker import resolved_run

SAMPLERS = ("tpe", "random", "qmc")
EXAMPLE = "as in learning_rate = { log_uniform = [1e-5, 1e-2] }"


def read_space(path: Path) -> tuple[grid.RunSpec, dict[str, Any], str]:
    """Return the run of a file with one task and one method, Optuna's distributions of its other options, and its sampler.

    Raises:
        ValueError: as `grid.read`, or there are several tasks, methods or values of an option, or no distribution.
    """
    table = grid.read_table(path)
    try:
        if "runs" in table:
            raise InputError("a search has no [[runs]]; it draws the options of its runs itself")
        options = grid.options_of(table)
        spaces = {name: _space(name, value) for name, value in sorted(options.items()) if isinstance(value, dict)}
        if not spaces:
            raise InputError(f"a search needs options with a distribution, {EXAMPLE}")
        if "reward_type" in spaces:
            raise InputError("a search compares one score, and reward_type decides between success and return: fix it")
        sampler = table.pop("sampler", SAMPLERS[0])
        require_known("sampler", sampler, SAMPLERS)
        fixed = {name: value for name, value in options.items() if name not in spaces}
        base, *others = itertools.islice(grid.block_specs({**table, "options": fixed}), 2)
        if others:
            raise InputError(
                "a search has one task, one method and one value of each option; a list can be a choice = [...]"
            )
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    return base, spaces, sampler


def _space(option: str, distribution: dict[str, Any]) -> Any:
    """Return Optuna's distribution of an option; choices are JSON texts, because Optuna has no lists."""
    spaces = optuna().distributions
    try:
        [(kind, values)] = distribution.items()
        if kind == "choice":
            return spaces.CategoricalDistribution([json.dumps(grid.without_null(value)) for value in values])
        low, high = values
        if kind == "integers":
            return spaces.IntDistribution(operator.index(low), operator.index(high))
        if kind not in ("uniform", "log_uniform") or not math.isfinite(high - low):
            raise ValueError(f"unknown distribution {kind!r}, or an end that is not finite")
        return spaces.FloatDistribution(float(low), float(high), log=kind == "log_uniform")
    except (TypeError, ValueError) as error:
        raise InputError(
            f"option {option} = {distribution} must be a choice of values, or the two ends of uniform, log_uniform or "
            f"integers, {EXAMPLE} ({error})"
        ) from error


def option(space: Any, value: Any) -> Any:
    """Return an option as Optuna proposed it, a float with four significant digits: the run's name has the exact value."""
    if isinstance(value, float):
        return min(max(float(f"{value:.4g}"), space.low), space.high)
    return json.loads(value) if isinstance(value, str) else value


def check_ends(base: grid.RunSpec, spaces: dict[str, Any]) -> None:
    """Raise a ValueError if an end of an interval, or one of the choices, is not a valid value of its option.

    A trial in the journal with such a value would end every later call of the search.
    """
    ends = {
        name: [option(space, end) for end in getattr(space, "choices", None) or (space.low, space.high)]
        for name, space in spaces.items()
    }
    first = {**base.options, **{name: values[0] for name, values in ends.items()}}
    for name, values in ends.items():
        for value in values:
            resolved_run(dataclasses.replace(base, options={**first, name: value}))


def optuna() -> Any:
    """Return the module of Optuna with a silent log; an InputError names the extra that installs it."""
    module = optional("optuna", "search needs", "search")
    module.logging.set_verbosity(module.logging.ERROR)
    warnings.filterwarnings("ignore", category=module.exceptions.ExperimentalWarning)
    return module
