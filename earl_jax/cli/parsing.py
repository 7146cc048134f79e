"""How the command line reads numbers: whole numbers as 1e6, lists of seeds."""

import re
from collections.abc import Sequence

from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from earl_jax.errors import InputError, brief

SEEDS = "--seeds"
SEED_TOKEN = re.compile(r"[\d_:,]+")
"""A count, a range or a list of seeds; no task is called so."""
LONGEST_EXPONENT = 18
"""The largest exponent of a number such as 1e6."""
REGISTRY = ConstructorRegistry()


@REGISTRY.primitive_rule
def whole_number_rule(kind: PrimitiveTypeInfo) -> PrimitiveConstructorSpec | None:
    """Return how an int is read, for the parser of commands."""
    if kind.type is not int:
        return None
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar="INT",
        instance_from_str=lambda texts: parse_whole(texts[0]),
        is_instance=lambda value: isinstance(value, int),
        str_from_instance=lambda value: [str(value)],
    )


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


def parse_seeds(text: str) -> int | Sequence[int]:
    """Return the seeds that `text` names: a count `5`, a range `5:10` without its end, or a list `3,5,8`.

    Raises:
        ValueError: it is none of them.
    """
    try:
        parts = [[parse_whole(end) for end in part.split(":")] for part in text.split(",") if part]
    except ValueError as error:
        raise InputError(f"{SEEDS}: {error}") from None
    if not parts or any(len(part) > 2 or part[0] >= part[-1] for part in parts if len(part) > 1):
        raise InputError(f"{SEEDS} takes a count (5), a range (5:10, without 10) or a list (3 5 8), not {brief(text)}")
    ranges = [range(part[0], part[-1] + (len(part) == 1)) for part in parts]
    if len(parts) == 1:
        return ranges[0] if len(parts[0]) == 2 else parts[0][0]
    if any(seeds.stop - seeds.start > 2**16 for seeds in ranges):
        raise InputError(f"{SEEDS}: {brief(text)} has a range of more than 65536 seeds")
    return [seed for seeds in ranges for seed in seeds]


def join_seeds(arguments: list[str]) -> list[str]:
    """Return the `arguments` of a command with the list after `--seeds` as one argument, so that it ends before a task.

    Raises:
        ValueError: `train`, `resume` or `reproduce` has the option `--seed`, which they lack.
    """
    if arguments[:1] not in (["train"], ["resume"], ["reproduce"]):
        return arguments
    if any(argument.partition("=")[0] == "--seed" for argument in arguments):
        raise InputError(
            f"there is no option --seed: use {SEEDS} (a count; except for reproduce also a range: 3:4 is seed 3 alone)"
        )
    joined: list[str] = []
    for argument in arguments:
        if joined[-2:-1] == [SEEDS] and all(map(SEED_TOKEN.fullmatch, (argument, joined[-1]))):
            joined[-1] += f",{argument}"
        else:
            joined.append(argument)
    return joined
