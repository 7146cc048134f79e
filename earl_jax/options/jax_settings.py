"""The settings of jax that affect numbers: those that the package fixes, and those that a run records."""

import contextlib
from collections.abc import Iterator
from typing import Any

import jax

from earl_jax.errors import InputError, brief

RECORDED: dict[str, Any] = {
    "jax_default_matmul_precision": None,
    "jax_default_prng_impl": "threefry2x32",
    "jax_disable_jit": False,
    "jax_disable_most_optimizations": False,
    "jax_random_seed_offset": 0,
    "jax_threefry_partitionable": True,
}
"""Settings that change the numbers of a run, with jax's defaults, which runs used before config.json recorded them."""


@contextlib.contextmanager
def package_types() -> Iterator[None]:
    """A context and a decorator in which jax has the types and rules that this package is written for.

    Numbers are float32 and int32, shapes and types are promoted as by default, and implicit transfers and reuse of keys
    are allowed, whatever the environment variables or the surrounding program have set.
    """
    with (
        jax.enable_x64(False),
        jax.numpy_rank_promotion("allow"),
        jax.numpy_dtype_promotion("standard"),
        jax.transfer_guard("allow"),
        jax.debug_key_reuse(False),
    ):
        yield


def recorded_settings() -> dict[str, Any]:
    """Return the values of the settings `RECORDED` in this process."""
    return {name: jax.config.values.get(name, default) for name, default in RECORDED.items()}


def require_settings(recorded: Any, source: str) -> None:
    """Raise an InputError if a setting in `recorded`, from the run `source`, has another value in this process."""
    if not isinstance(recorded, dict):
        raise InputError(f"{source} is damaged: jax must be a dict, not {brief(recorded)}")
    for name, now in recorded_settings().items():
        default = RECORDED[name]
        value = recorded.get(name, default)
        if value != now:
            remedy = f"unset {name.upper()}" if value == default else f"set {name.upper()}={value}"
            raise InputError(
                f"{source} was trained with {name} {brief(value)}, and here it is {brief(now)}, which can change its "
                f"numbers; {remedy} to continue or repeat the run"
            )
