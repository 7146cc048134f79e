"""Seeds as the command line, sweep files and Python take them: a number of them, a range such as 5:10, or a list."""

import operator
import re
from collections.abc import Sequence

from earl_jax.errors import InputError, brief

LONGEST_EXPONENT = 18
"""The largest exponent of a number such as 1e6."""


def seed_list(seeds: int | str | Sequence[int]) -> Sequence[int]:
    """Return the seeds of an argument: a number of them (5 for 0 to 4), `"5:10"` without its end, `"3,5,8"`, or a list.

    Raises:
        ValueError: it is none of them.
    """
    if isinstance(seeds, str):
        seeds = parse_seeds(seeds)
    if isinstance(seeds, int):
        return range(seeds)
    if isinstance(seeds, range):
        return seeds
    try:
        return [operator.index(seed) for seed in seeds]
    except TypeError:
        raise InputError(f"seeds must be whole numbers, not {brief(seeds)}") from None


def parse_whole(text: str) -> int:
    """Return the whole number `text`, which can be written as 1e6, 2.5e6 or 2_500_000.

    Raises:
        ValueError: it is no whole number.
    """
    try:
        return int(text)
    except ValueError:
        mantissa, e, exponent = text.lower().partition("e")
    if not e or not re.fullmatch(r"[+-]?\d[\d_]*(\.\d+)?", mantissa) or not re.fullmatch(r"\+?\d{1,2}", exponent):
        raise ValueError(f"{brief(text)} is not a whole number such as 1000000, 1_000_000 or 1e6")
    whole, _, decimals = mantissa.partition(".")
    if not len(decimals.rstrip("0")) <= int(exponent) <= LONGEST_EXPONENT:
        raise ValueError(f"{brief(text)} is not a whole number below 1e{LONGEST_EXPONENT}")
    return int(f"{whole}{decimals.rstrip('0')}") * 10 ** (int(exponent) - len(decimals.rstrip("0")))


def parse_seeds(text: str, name: str = "seeds") -> int | Sequence[int]:
    """Return the seeds that `text` names: a count `5`, a range `5:10` without its end, or a list `3,5,8`.

    Raises:
        ValueError: it is none of them; the message begins with `name`.
    """
    try:
        parts = [[parse_whole(end) for end in part.split(":")] for part in text.split(",") if part]
    except ValueError as error:
        raise InputError(f"{name}: {error}") from None
    if not parts or any(len(part) > 2 or part[0] >= part[-1] for part in parts if len(part) > 1):
        raise InputError(f"{name} takes a count (5), a range (5:10, without 10) or a list (3,5,8), not {brief(text)}")
    ranges = [range(part[0], part[-1] + (len(part) == 1)) for part in parts]
    if len(parts) == 1:
        return ranges[0] if len(parts[0]) == 2 else parts[0][0]
    if any(seeds.stop - seeds.start > 2**16 for seeds in ranges):
        raise InputError(f"{name}: {brief(text)} has a range of more than 65536 seeds")
    return [seed for seeds in ranges for seed in seeds]
