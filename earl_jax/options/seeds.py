"""The seeds of a run, given as a number, a range or a list, and the check of all of them."""

import collections
import itertools
import operator
from collections.abc import Iterable, Mapping, Sequence, Set
from typing import Any

from earl_jax.errors import InputError, brief
from earl_jax.options.values import SEED, parse_whole, require

SEEDS = 5
"""The default number of seeds for `train`, the command line and sweep files."""
MOST_SEEDS = 2**16


def seed_list(seeds: int | str | Sequence[int]) -> tuple[int, ...]:
    """Return the seeds that an argument names: their number (5: 0 to 4), `"5:10"` (without 10), `"3,5,8"`, or a list.

    Raises:
        InputError: it has another form, or names no seed, a seed twice, more than `MOST_SEEDS`, or one outside `SEED`.
    """
    named: Any = _parsed(seeds) if isinstance(seeds, str) else seeds
    try:
        if isinstance(named, bytes | Set | Mapping):  # numbers in another order than written, or none
            raise TypeError
        some = named if isinstance(named, Iterable) else range(_whole(named))
        whole = tuple(map(_whole, itertools.islice(some, MOST_SEEDS + 1)))  # a range can be endless
    except TypeError:
        raise InputError(f"seeds must be whole numbers, not {brief(seeds)}") from None
    if len(whole) > MOST_SEEDS:
        raise InputError(f"at most {MOST_SEEDS} seeds fit in one run; split them over several runs")
    if not whole:
        raise InputError(f"seeds must name at least one, not {brief(seeds)}")
    seed, count = collections.Counter(whole).most_common(1)[0]
    if count > 1:
        raise InputError(f"seed {seed} is given twice")
    for seed in (min(whole), max(whole)):
        require("seeds", seed, SEED)
    return whole


def lane_of(seed: Any, seeds: Sequence[int], where: str) -> int:
    """Return the lane of `seed`, for None the first; if `seed` is not `where`, an InputError lists the `seeds`."""
    if seed is not None and seed not in seeds:
        raise InputError(f"no seed {brief(seed)} {where}; choose from {', '.join(map(str, seeds))}")
    return 0 if seed is None else seeds.index(seed)


def _whole(seed: Any) -> int:
    if isinstance(seed, bool):
        raise TypeError
    return operator.index(seed)


def _parsed(text: str) -> int | Iterable[int]:
    """Return the count or the seeds that `text` names; `3,` is seed 3 alone."""
    try:
        parts = [[parse_whole(end) for end in part.split(":")] for part in text.split(",") if part]
    except ValueError as error:
        raise InputError(f"seeds: {error}") from None
    if not parts or any(len(part) > 2 or part[0] >= part[-1] for part in parts if len(part) > 1):
        raise InputError(f"seeds takes a count (5), a range (5:10, without 10) or a list (3,5,8), not {brief(text)}")
    if "," not in text and ":" not in text:
        return parts[0][0]
    return itertools.chain(*(range(part[0], part[-1] + (len(part) == 1)) for part in parts))
