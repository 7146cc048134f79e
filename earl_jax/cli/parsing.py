"""How the command line reads numbers: whole numbers as 1e6, lists of seeds."""

import re

from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from earl_jax.errors import InputError
from earl_jax.options import parse_whole

SEEDS = "--seeds"
SEED_TOKEN = re.compile(r"[\d_:,]+")
"""A count, a range or a list of seeds; no task is called so."""
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


def join_seeds(arguments: list[str]) -> list[str]:
    """Return the `arguments` of a command with the list after `--seeds` as one argument, so that it ends before a task.

    Raises:
        ValueError: `train` or `reproduce` has the option `--seed`, which they lack.
    """
    if arguments[:1] not in (["train"], ["reproduce"]):
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
