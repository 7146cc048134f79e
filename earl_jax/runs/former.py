"""Defaults of methods that have changed: a config of an earlier version keeps those of its time. It loads no array."""

from typing import Any

from earl_jax.errors import InputError, brief

FORMAT = 2
"""The number of the format that config.json names. A file that names none has format 1."""
CHANGED: dict[str, dict[str, tuple[Any, Any]]] = {
    "vaprl": {"nearest_fallback": (False, True), "unmet_goals": (False, True)}
}
"""Defaults of format 1 and of today, by method and option, where they differ."""


def former_defaults(algo: str, number: int) -> dict[str, Any]:
    """Return the defaults of a method in configs of format `number` that differ from today's, by option."""
    return {name: former for name, (former, _) in CHANGED.get(algo, {}).items()} if number < FORMAT else {}


def current_values(values: dict[str, Any]) -> dict[str, Any]:
    """Return the values of a config.json of any format as those of today's, which its `format` says.

    A config names the options of its method that differ from the defaults of its time; the result names those that
    differ from today's.

    Raises:
        ValueError: a later version wrote the file.
    """
    number, algo, options = values.get("format", 1), values.get("algo"), values.get("options")
    if number not in range(1, FORMAT + 1):
        raise InputError(f"its format is {brief(number)}, and this version of earl_jax reads 1 to {FORMAT}: update it")
    values = {**values, "format": FORMAT}
    if not isinstance(algo, str) or not isinstance(options, dict) or values.get("algo_class"):
        return values
    former = former_defaults(algo, number)
    today = {name: CHANGED[algo][name][1] for name in former}
    explicit = {**former, **options}
    return {**values, "options": {name: value for name, value in explicit.items() if today.get(name, ...) != value}}
