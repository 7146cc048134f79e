"""Checks of options that come by name from a command line, a config or a notebook."""

import dataclasses
import math
import numbers
import typing
from collections.abc import Mapping
from typing import Any

import numpy as np

from earl_jax.errors import InputError

KINDS = {bool: "true or false", int: "a whole number of at least 0", float: "a finite number", str: "text"}


def check(owner: str, factory: type, options: Mapping[str, Any]) -> None:
    """Check that the dataclass `factory` has every option, and that each value has the type of its default.

    Raises:
        ValueError: an option is unknown or has the wrong type; the message names `owner`, the option and the valid choices.
    """
    fields = {field.name: field for field in dataclasses.fields(factory)}
    for option, value in options.items():
        if option not in fields:
            raise InputError(f"{owner} has no option {option!r}; choose from {', '.join(fields)}")
        default = fields[option].default
        if isinstance(default, tuple):
            if not _is_sizes(value):
                raise InputError(f"{owner}: {option} must be whole numbers of at least 1, not {value!r}")
            continue
        kind = type(default) if default is not None else _type_beside_none(fields[option].type)
        if kind in KINDS and not _fits(kind, value) and not (value is None and default is None):
            raise InputError(f"{owner}: {option} must be {KINDS[kind]}, not {value!r}")


def _type_beside_none(annotation: Any) -> Any:
    """Return the type T of an annotation `T | None`, or None for any other annotation."""
    return next((kind for kind in typing.get_args(annotation) if kind is not type(None)), None)


def _is_sizes(value: Any) -> bool:
    return isinstance(value, tuple) and bool(value) and all(_fits(int, size) and size for size in value)


def _fits(kind: Any, value: Any) -> bool:
    """Return whether `value` has the type `kind`; for numbers and flags, an array with a value for each lane does too."""
    if kind is str or (kind is bool and isinstance(value, bool)):
        return isinstance(value, kind)
    if kind is int:
        return isinstance(value, numbers.Integral) and not isinstance(value, bool) and int(value) >= 0
    if isinstance(value, np.ndarray):
        return value.dtype.kind in "fiub" and bool(np.isfinite(value).all())
    if hasattr(value, "dtype") and not isinstance(value, np.generic):
        return True  # a jax array, whose values may be unknown under a trace
    return kind is float and isinstance(value, numbers.Real) and not isinstance(value, bool) and math.isfinite(value)
