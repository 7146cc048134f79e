"""Options by name, as a command line, a config or a notebook gives them: known, and of the kind that their defaults are."""

import dataclasses
import math
import numbers
import typing
from collections.abc import Mapping
from typing import Any

import numpy as np

KINDS = {bool: "true or false", int: "a whole number of at least 0", float: "a finite number", str: "text"}


def check(what: str, factory: type, options: Mapping[str, Any]) -> None:
    """Refuse options that the dataclass `factory` does not have, or that are not of the kind of its defaults.

    Raises:
        ValueError: the message names the option, and what it may be.
    """
    fields = {field.name: field for field in dataclasses.fields(factory)}
    for option, value in options.items():
        if option not in fields:
            raise ValueError(f"{what} has no option {option!r}; choose from {', '.join(fields)}")
        default = fields[option].default
        if isinstance(default, tuple):
            if not value or not isinstance(value, tuple) or not all(_fits(int, size) and size for size in value):
                raise ValueError(f"{what}: {option} must be whole numbers of at least 1, not {value!r}")
            continue
        kind = type(default) if default is not None else _beside_none(fields[option].type)
        if kind in KINDS and not _fits(kind, value) and not (value is None and default is None):
            raise ValueError(f"{what}: {option} must be {KINDS[kind]}, not {value!r}")


def _beside_none(annotation: Any) -> Any:
    """Return the type that stands beside None in an annotation."""
    return next((kind for kind in typing.get_args(annotation) if kind is not type(None)), None)


def _fits(kind: Any, value: Any) -> bool:
    """Return whether `value` is of `kind`; an array stands for a number or flag of several lanes."""
    if kind is str or (kind is bool and isinstance(value, bool)):
        return isinstance(value, kind)
    if kind is int:
        return isinstance(value, numbers.Integral) and not isinstance(value, bool) and int(value) >= 0
    if isinstance(value, np.ndarray):
        return value.dtype.kind in "fiub" and bool(np.isfinite(value).all())
    if hasattr(value, "dtype") and not isinstance(value, np.generic):
        return True  # jax's, whose values may not be known
    return kind is float and isinstance(value, numbers.Real) and not isinstance(value, bool) and math.isfinite(value)
