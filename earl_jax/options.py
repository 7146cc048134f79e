"""Checks of options that come by name from a command line, a config or a notebook.

A field declares the interval of its valid values in its metadata: `field(default=0.99, metadata=within("[0, 1)"))`.
"""

import dataclasses
import math
import numbers
import typing
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from earl_jax.errors import InputError, brief

LARGEST_INT = 2**31 - 1
"""The largest count that a program can hold: int32."""


class Interval(NamedTuple):
    """The valid values of an option, in the usual notation: `(0, 1]` excludes 0 and includes 1."""

    text: str

    def contains(self, value: Any) -> bool:
        """Return whether every number in `value` lies in the interval; values that a trace hides are taken to."""
        if hasattr(value, "dtype") and not isinstance(value, np.ndarray | np.generic):
            return True  # a jax array
        low, high = (float(end) for end in self.text[1:-1].split(","))
        try:
            values = np.asarray(value, np.float64)
        except OverflowError:  # an int of hundreds of digits
            return False
        above = values > low if self.text[0] == "(" else values >= low
        below = values < high if self.text[-1] == ")" else values <= high
        return bool((above & below).all())


COUNT = Interval(f"[1, {LARGEST_INT}]")
"""The valid numbers of steps or transitions."""
COUNT_OR_NEVER = Interval(f"[0, {LARGEST_INT}]")
"""The valid numbers of steps between two events; 0 for never."""


def within(interval: str | Interval) -> dict[str, Interval]:
    """Return the metadata of a field whose values lie in `interval`, such as `[0, 1)`."""
    return {"interval": Interval(interval) if isinstance(interval, str) else interval}


def require(name: str, value: Any, interval: Interval) -> None:
    """Raise an InputError with the option `name` and its `interval` if `value` is outside it."""
    if not interval.contains(value):
        raise InputError(f"{name} must lie in {interval.text}, not {brief(value)}")


def check_intervals(owner: str, options: Any) -> None:
    """Check the fields of the dataclass `options` that declare an interval; None is always valid. Errors as `check`."""
    for field in dataclasses.fields(options):
        value = getattr(options, field.name)
        if "interval" in field.metadata and value is not None:
            require(f"{owner}: {field.name}", value, field.metadata["interval"])


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
        expected = _expected(fields[option], value)
        if expected:
            raise InputError(f"{owner}: {option} must be {expected}, not {brief(value)}")
        if "interval" in fields[option].metadata and value is not None:
            require(f"{owner}: {option}", value, fields[option].metadata["interval"])


def _expected(field: dataclasses.Field, value: Any) -> str | None:
    """Return the kind of value that `field` takes if `value` is of another kind, else None."""
    default = field.default
    if isinstance(default, tuple):
        return None if _is_sizes(value) else "whole numbers of at least 1"
    kind = type(default) if default is not None else _type_beside_none(field.type)
    fits = kind not in KINDS or _fits(kind, value) or (value is None and default is None)
    return None if fits else KINDS[kind]


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
    return kind is float and isinstance(value, numbers.Real) and not isinstance(value, bool) and _is_finite(value)


def _is_finite(value: Any) -> bool:
    try:
        return math.isfinite(value)
    except OverflowError:  # an int of hundreds of digits
        return False
