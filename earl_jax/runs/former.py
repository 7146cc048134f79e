"""Configs of earlier versions, read as today's: renamed options of tasks, and defaults of methods that have changed."""

from typing import Any

from earl_jax.algos import algo_class
from earl_jax.envs import current_options
from earl_jax.errors import InputError, brief

FORMAT = 2
"""The number of the format that config.json names. A file that names none has format 1."""
FORMER_DEFAULTS: dict[str, dict[str, Any]] = {"vaprl": {"nearest_fallback": False, "unmet_goals": False}}
"""Defaults of format 1 that differ from today's, by method and option."""


def current_values(values: dict[str, Any]) -> dict[str, Any]:
    """Return the values of a config.json of any format as one of today's, without its format.

    A config names the options that differ from the defaults of its time; the result names those that differ from
    today's. A task that is not registered keeps its options.

    Raises:
        ValueError: a later version wrote the file.
    """
    values = dict(values)
    number = values.pop("format", 1)
    if number not in range(1, FORMAT + 1):
        raise InputError(f"its format is {brief(number)}, and this version of earl_jax reads 1 to {FORMAT}: update it")
    if number == 1:
        values = _with_former_defaults(values)
    try:
        return {**values, "env_options": current_options(values["env"], values["env_options"])}
    except (KeyError, TypeError, ValueError):
        return values


def _with_former_defaults(values: dict[str, Any]) -> dict[str, Any]:
    """Return `values` of format 1 with the method's options that differ from today's defaults."""
    algo, options = values.get("algo"), values.get("options")
    if not isinstance(algo, str) or not isinstance(options, dict) or values.get("algo_class"):
        return values
    former = FORMER_DEFAULTS.get(algo, {})
    today = {name: getattr(algo_class(algo)(), name) for name in former}
    explicit = {**former, **options}
    return {**values, "options": {name: value for name, value in explicit.items() if today.get(name, ...) != value}}
