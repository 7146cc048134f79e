"""The choice of a run's physics engine: the requested one, or the fastest one by measured costs."""

import importlib.util
from typing import NamedTuple

from jax import default_backend, local_device_count

from earl_jax.errors import InputError, install_line
from earl_jax.options.environment import core_count

DEFAULT_ENGINES = {"cpu": "c", "gpu": "c"}
"""The engine that `auto` selects for few lanes on a backend, by benchmarks/results/physics; other backends (TPU) use
mjx."""
DEVICE_LANES = 1000
"""The number of lanes at which device costs were measured."""


class EngineCost(NamedTuple):
    """Measured milliseconds of a task's control step, on one H200 with 16 cores (benchmarks/results/physics).

    `host` is the time of one core for one lane with `c`. `device` and `warp` are the times of 1,000 lanes with `mjx`
    and with `warp`; fewer lanes are hardly faster. None means that the engine was not measured.
    """

    host: float
    device: float | None = None
    warp: float | None = None


def has_warp() -> bool:
    """Return whether warp is installed; the libraries of the other engines come with the package."""
    return importlib.util.find_spec("warp") is not None


def resolve_engine(engine: str) -> str:
    """Return `engine`, with `auto` replaced by this backend's default for few lanes.

    Raises:
        ValueError: the engine is not installed; the message names the extra that installs it.
    """
    if engine == "auto":
        return DEFAULT_ENGINES.get(default_backend(), "mjx")
    if engine == "warp" and not has_warp():
        raise InputError(f"physics engine {engine!r} is not installed: {install_line('warp')}")
    return engine


def fastest_engine(cost: EngineCost | None, lanes: int) -> str:
    """Return the installed engine with the shortest control step for `lanes` lanes here, by a task's measured `cost`.

    Without a cost, or on any backend but a GPU, it is the default engine. `warp` is chosen for at most 1,000 lanes, the
    number for which its capacity of contacts was measured to suffice.
    """
    default = resolve_engine("auto")
    if default_backend() != "gpu" or cost is None:
        return default
    times = {default: lanes * cost.host / (core_count() / local_device_count())}
    if cost.device is not None:
        times["mjx"] = cost.device * max(1.0, lanes / DEVICE_LANES)
    if cost.warp is not None and lanes <= DEVICE_LANES and has_warp():
        times["warp"] = cost.warp
    return min(times, key=times.__getitem__)
