"""Option values from a command line, a config or a notebook: checks, whole numbers, and time limits.

Before an object is made, `check` its options by name; `check_intervals` of the object afterwards. `require` is for a
single number, `require_object` for an argument that is an object or its name, `check_storable` for values of a file.

A field declares the interval of its valid values in its metadata: `field(default=0.99, metadata=within("[0, 1)"))`.
"""

import dataclasses
import inspect
import math
import numbers
import re
import time
import typing
from collections.abc import Mapping
from typing import Any, NamedTuple

from earl_jax.errors import InputError, annotations, brief

LARGEST_INT = 2**31 - 1
"""The largest count that a program can hold: int32."""
LONGEST_EXPONENT = 18
"""The largest exponent of a number such as 1e6."""
DEEPEST = 8
"""Largest number of nested lists and dictionaries in an option."""


class Interval(NamedTuple):
    """The valid values of an option: `(0, 1]` excludes 0 and includes 1; a `whole` one is for a single whole number."""

    text: str
    whole: bool = False

    def contains(self, value: Any) -> bool:
        """Return whether `value` is a number in the interval, or an array or list of such numbers."""
        import numpy as np  # without it, the commands that only read start faster

        low, high = (float(end) for end in self.text[1:-1].split(","))
        try:
            given = np.asarray(value)
            if given.dtype.kind in "bcSU":  # flags and text of digits, which NumPy would convert
                return False
            values = given.astype(np.float64)
        except (OverflowError, TypeError, ValueError):  # an int of hundreds of digits, or no number
            return False
        above = values > low if self.text[0] == "(" else values >= low
        below = values < high if self.text[-1] == ")" else values <= high
        return bool((above & below).all())


COUNT = Interval(f"[1, {LARGEST_INT}]", whole=True)
"""The valid numbers of steps or transitions."""
COUNT_OR_NEVER = Interval(f"[0, {LARGEST_INT}]", whole=True)
"""The valid numbers of steps between two events; 0 for never."""
SEED = Interval(f"[0, {2**32 - 1}]", whole=True)
EPISODES = Interval("[1, 100000]", whole=True)
"""The valid numbers of episodes of an evaluation."""


def within(interval: str | Interval, **unless: Any) -> dict[str, Any]:
    """Return metadata for a field in `interval`, such as `[0, 1)`, unused if a field in `unless` has its value."""
    return {"interval": Interval(interval) if isinstance(interval, str) else interval, "unless": unless}


def require(name: str, value: Any, interval: Interval) -> None:
    """Raise an InputError with the option `name` and its `interval` if `value` is outside; traced values pass."""
    value = _known(value)
    if _is_of_jax(value):
        return
    if interval.whole and not _is_whole(value):
        raise InputError(f"{name} must be a whole number, not {brief(value)}")
    if not interval.contains(value):
        raise InputError(f"{name} must lie in {interval.text}, not {brief(value)}")


def require_object(noun: str, given: Any, kind: type, or_name: bool = True) -> None:
    """Raise an InputError unless `given` is an object of `kind`, or a name if `or_name`; its class must set its `name`."""
    if not isinstance(given, kind) and not (or_name and isinstance(given, str)):
        call = f"; did you mean {given.__name__}()?" if isinstance(given, type) else ""
        wanted = f"{'a name or ' * or_name}an object of {kind.__name__}"
        raise InputError(f"the {noun} must be {wanted}, not {brief(given)}{call}")
    if "name" in annotations(kind) and isinstance(given, kind) and not hasattr(given, "name"):
        raise InputError(f"the class {type(given).__name__} needs a `name`, as in name: ClassVar[str] = 'mine'")


def _check_defaults(owner: str, cls: type) -> None:
    """Raise an InputError if the class sets a field in a way that the dataclass ignores, keeping another default."""
    for field in dataclasses.fields(cls):
        default = field.default
        value = default if default is dataclasses.MISSING else getattr(cls, field.name, default)
        if value is not default and repr(value) != repr(default):  # `%autoreload` leaves an equal one in the class
            fix = f"write `{field.name}: TYPE = ...`, in a task below @dataclasses.dataclass(frozen=True)"
            raise InputError(f"{owner}: the value of {field.name} in {cls.__name__} is not its default; {fix}")


def check_intervals(owner: str, options: Any) -> None:
    """Check the fields of `options` that declare choices or an interval, which None passes. Errors as `check`."""
    _check_defaults(owner, type(options))
    for name, valid in literals(type(options)).items():
        if (value := getattr(options, name)) not in valid:
            raise InputError(f"{name} {brief(value)} is not one of {', '.join(map(str, valid))}")
    for field in dataclasses.fields(options):
        value = getattr(options, field.name)
        if not field.metadata.get("pytree_node", True) and getattr(value, "shape", ()):  # a program is looked up by it
            fix = "must be a plain value, such as a tuple"
            raise InputError(f"{owner}: {field.name} {fix}, not the array {brief(value)}")
        if "interval" in field.metadata and value is not None:
            interval = field.metadata["interval"]
            require(f"{owner}: {field.name}", value, interval._replace(whole=interval.whole or field.type is int))


def literals(cls: type) -> dict[str, tuple[Any, ...]]:
    """Return the valid values of the fields of `cls` whose type, in `cls` or an overridden base, is `Literal[...]`."""
    return {
        name: (*typing.get_args(part), *[None] * (kind != part))
        for name, kind in _annotations(cls)
        for part in (kind, *typing.get_args(kind))
        if typing.get_origin(part) is typing.Literal and kind in (part, part | None)
    }


def _annotations(cls: type) -> list[tuple[str, Any]]:
    """Return names and types of the fields of all bases of `cls`, then its own; a type that has no value stays text."""
    items = []
    for base in reversed(cls.__mro__):
        try:
            items += inspect.get_annotations(base, eval_str=True).items()
        except Exception:  # such as the name of a type that is imported for type checkers alone
            items += annotations(base).items()
    return items


def check_storable(owner: str, values: Any, depth: int = 0) -> None:
    """Raise an InputError that names `owner` if `values` are nested too deeply or contain too large a number."""
    if depth > DEEPEST:
        raise InputError(f"{owner} has more than {DEEPEST} levels of lists")
    if isinstance(values, int) and abs(values) >= 2**63:
        raise InputError(f"{owner} is or holds a number that is too large: {brief(values)}")
    inner = list(values.values()) if isinstance(values, dict) else values
    for value in inner if isinstance(inner, list | tuple) else ():
        check_storable(owner, value, depth + 1)


KINDS = {bool: "true or false", int: "a whole number of at least 0", float: "a finite number", str: "text"}


def check(owner: str, factory: type, options: Mapping[str, Any]) -> None:
    """Check that the dataclass `factory` has every option, and that each value has the type of its field or default.

    Raises:
        ValueError: an option is unknown or has the wrong type; the message names `owner`, the option and the valid choices.
    """
    _check_defaults(owner, factory)
    fields, types = {field.name: field for field in dataclasses.fields(factory)}, dict(_annotations(factory))
    for option, value in options.items():
        if option not in fields:
            raise InputError(f"{owner} has no option {option!r}; choose from {', '.join(fields)}")
        if expected := _expected(fields[option], types[option], value):
            raise InputError(f"{owner}: {option} must be {expected}, not {brief(value)}")
        if "interval" in fields[option].metadata and value is not None:
            require(f"{owner}: {option}", value, fields[option].metadata["interval"])


def _expected(field: dataclasses.Field, annotation: Any, value: Any) -> str | None:
    """Return the kind of value that `field` requires by its `annotation` if `value` is of another kind, else None."""
    default = field.default
    if isinstance(default, tuple):
        kind = type(default[0]) if default else None
        fits = isinstance(value, tuple) and all(kind not in KINDS or _fits(kind, item) for item in value)
        if kind is int:
            return None if fits and value and all(value) else "a list of whole numbers of at least 1, such as [256,256]"
        return None if fits else "a list" + f", each of its values {KINDS.get(kind)}" * (kind in KINDS)
    parts = typing.get_args(annotation)
    may_be_none = default is None or type(None) in parts
    declared = next((part for part in parts if part is not type(None)), None) if may_be_none else annotation
    kind = declared if declared in KINDS else type(default)
    if kind is int and "interval" in field.metadata and value is not None:  # `require` names its ends
        return None if _is_whole(value) else "a whole number" + " or null" * may_be_none
    has_lanes = field.metadata.get("pytree_node", True)
    fits = kind not in KINDS or _fits(kind, value, has_lanes) or (value is None and may_be_none)
    return None if fits else KINDS[kind] + " or null" * may_be_none


def _fits(kind: Any, value: Any, has_lanes: bool = False) -> bool:
    """Return whether `value` has the type `kind`; if `has_lanes`, an array of numbers or flags per lane also has."""
    import numpy as np

    if kind is str:
        return isinstance(value, str)
    if kind is int:
        return _is_whole(value) and int(value) >= 0
    value = _known(value) if has_lanes else value
    if has_lanes and isinstance(value, np.ndarray):
        if kind is bool:
            return bool(np.isin(value, (0, 1)).all())
        return value.dtype.kind in "fiub" and bool(np.isfinite(value).all())
    is_flag = kind is bool and isinstance(value, bool | np.bool_)
    return is_flag or (has_lanes and _is_of_jax(value)) or (kind is float and _is_number(value))


def value_text(value: Any) -> str:
    """Return a number as people write it, such as 222.86, 20000, 3e-4 or 1e9, and any other value as `str` does."""
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(value_text, value))}]"
    if not isinstance(value, float):
        return str(value)
    digits, _, exponent = format(value, ".5e" if 0 < abs(value) < 1e-3 else ".6g").partition("e")
    return f"{digits.rstrip('0').rstrip('.')}e{int(exponent)}" if exponent else digits


def counted(number: int, noun: str) -> str:
    """Return a number with its noun, such as `1 seed` or `1,000 seeds`."""
    return f"{number:,} {noun}{'s' * (number != 1)}"


def _is_whole(value: Any) -> bool:
    return isinstance(value, numbers.Integral) and not isinstance(value, bool)


def _is_of_jax(value: Any) -> bool:
    return hasattr(value, "dtype") and type(value).__module__ != "numpy"


def _known(value: Any) -> Any:
    """Return a jax array as a NumPy array or number, unless it is traced; other values stay as they are."""
    if not _is_of_jax(value):
        return value
    import jax
    import numpy as np
    from jax.core import Tracer

    if isinstance(value, Tracer) or not isinstance(value, jax.Array):
        return value
    is_float = jax.numpy.issubdtype(value.dtype, jax.numpy.floating)
    return np.asarray(value, np.float64 if is_float else None)[()]  # NumPy knows no bfloat16


def _is_number(value: Any) -> bool:
    try:
        return isinstance(value, numbers.Real) and not isinstance(value, bool) and math.isfinite(value)
    except OverflowError:  # an int of hundreds of digits
        return False


def parse_whole(text: str) -> int:
    """Return the whole number `text`, which can be written as 1e6, 2.5e6 or 2_500_000.

    Raises:
        ValueError: it is not a whole number.
    """
    try:
        return int(text)
    except ValueError:
        parts = re.fullmatch(r"([+-]?\d+(?:_\d+)*)(?:\.(\d+))?[eE]\+?(\d{1,2})", text)
    if not parts:
        raise ValueError(f"{brief(text)} is not a whole number such as 1000000, 1_000_000 or 1e6")
    decimals, exponent = (parts[2] or "").rstrip("0"), int(parts[3])
    if not len(decimals) <= exponent <= LONGEST_EXPONENT:
        raise ValueError(f"{brief(text)} is not a whole number below 1e{LONGEST_EXPONENT}")
    return int(parts[1] + decimals) * 10 ** (exponent - len(decimals))


def parse_number(text: str) -> int | float:
    """Return a number with a point or an exponent: a count such as 1e6 as an int, any other number as a float."""
    number = float(text)
    is_count = "e" in text.lower() and number.is_integer() and abs(number) <= LARGEST_INT
    return int(number) if is_count else number


class TimeLimit(NamedTuple):
    """A limit of `minutes` that ends at the time `ends_at` of the monotonic clock, which all processes here share."""

    minutes: float
    ends_at: float

    @classmethod
    def of(cls, minutes: Any) -> "TimeLimit | None":
        """Return the limit of `minutes` from now on; a running limit, or None, is returned as it is.

        Raises:
            ValueError: `minutes` is not a positive finite number.
        """
        if minutes is None or isinstance(minutes, cls):
            return minutes
        if not _is_number(minutes) or minutes <= 0:
            raise InputError(f"minutes must lie in (0, inf), not {brief(minutes)}")
        return cls(float(minutes), time.monotonic() + 60 * float(minutes))

    @property
    def passed(self) -> bool:
        """Whether the minutes have run out."""
        return time.monotonic() >= self.ends_at

    def __str__(self) -> str:
        return f"{self.minutes:g} minute{'' if self.minutes == 1 else 's'}"
