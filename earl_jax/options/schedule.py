"""The schedule of a run, with the defaults for every way to start a run."""

import bisect
import dataclasses
import math

from earl_jax.errors import InputError
from earl_jax.options.values import COUNT, EPISODES, require, within


@dataclasses.dataclass(frozen=True)
class Schedule:
    """How long each seed trains, and when it is evaluated and saved."""

    steps: int = dataclasses.field(default=100_000, metadata=within(COUNT))
    """Training steps of each seed."""
    eval_every: int = dataclasses.field(default=10_000, metadata=within(COUNT))
    """Steps between evaluations."""
    eval_episodes: int = dataclasses.field(default=10, metadata=within(EPISODES))
    """Greedy episodes of each deployed evaluation."""
    checkpoint_every: int = dataclasses.field(default=100_000, metadata=within(COUNT))
    """Steps between checkpoints."""

    def changed(self, **changes: int | None) -> "Schedule":
        """Return this schedule updated with the `changes` that are not None."""
        return dataclasses.replace(self, **{name: value for name, value in changes.items() if value is not None})

    def check(self) -> None:
        """Raise an InputError that names a value that is not a whole number in its interval."""
        for field in dataclasses.fields(self):
            require(field.name, getattr(self, field.name), field.metadata["interval"])


FIELDS = tuple(field.name for field in dataclasses.fields(Schedule))


def require_whole_windows(steps: int, eval_every: int) -> None:
    """Raise an InputError unless training ends with an evaluation: `steps`, a count, is a multiple of `eval_every`."""
    if steps % eval_every == 0:
        return
    small = [number for number in range(1, math.isqrt(steps) + 1) if steps % number == 0]
    divisors = sorted({*small, *(steps // number for number in small)})
    place, shorter = bisect.bisect(divisors, eval_every), steps // eval_every * eval_every
    every = " or ".join(map(str, divisors[place - 1 : place + 1]))
    lengths = " or ".join(str(length) for length in (shorter, shorter + eval_every) if length)
    problem = f"steps {steps} is not a multiple of eval_every {eval_every}"
    raise InputError(f"{problem}; choose eval_every {every}, or steps {lengths}")
