"""The wall-clock limit of a command: `minutes` from its start."""

import time
from numbers import Real
from typing import Any, NamedTuple

from earl_jax.errors import InputError, brief

VALID = "(0, inf)"
"""As `earl_jax.options.Interval` writes it, which needs NumPy: the launcher of sweeps does without."""


def _is_positive(value: Any) -> bool:
    try:
        return isinstance(value, Real) and not isinstance(value, bool) and 0 < float(value) < float("inf")
    except OverflowError:  # an int of hundreds of digits
        return False


class TimeLimit(NamedTuple):
    """A limit of `minutes` that `ends_at` a time in seconds since 1970, so that other processes can share it."""

    minutes: float
    ends_at: float

    @classmethod
    def of(cls, minutes: Any) -> "TimeLimit | None":
        """Return the limit of `minutes` from now on; a limit that runs already, or None, is returned as it is.

        Raises:
            ValueError: `minutes` is not a positive finite number.
        """
        if minutes is None or isinstance(minutes, cls):
            return minutes
        if not _is_positive(minutes):
            raise InputError(f"minutes must lie in {VALID}, not {brief(minutes)}")
        return cls(float(minutes), time.time() + 60 * float(minutes))

    @property
    def passed(self) -> bool:
        """Whether the minutes have run out."""
        return time.time() >= self.ends_at

    def __str__(self) -> str:
        return f"{self.minutes:g} minute{'' if self.minutes == 1 else 's'}"
