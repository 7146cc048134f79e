"""A workaround for slow programs of MuJoCo MJX on CPUs; no other module uses MJX's private modules.

XLA's CPU compiler fuses MJX's scan along a chain of bodies and recomputes every parent in each child. The cost is
exponential in the length of the chain: 248 ms instead of 0.4 ms for one step of the Sawyer arm. An optimization barrier
on the scan's carry prevents the fusion and changes no value.
"""

import functools
import importlib
from importlib import metadata
from typing import Any

import jax

AFFECTED_JAXLIB = (0, 10)
FIXED_JAXLIB = (0, 12)
"""The first release of jaxlib with the slow fusion, and the first one measured to be as fast without the barrier."""


def guard_kinematics() -> bool:
    """Add a barrier to MJX's `scan.body_tree`, once and only if this process needs it; return whether it is present.

    Raises:
        ImportError: MJX has no `scan.body_tree`; the message names its version.
    """
    if not needs_guard():
        return False
    _guard(importlib.import_module("mujoco.mjx._src.scan"))
    return True


def needs_guard() -> bool:
    """Return whether programs run on a CPU under a release of jaxlib with the slow fusion."""
    return jax.default_backend() == "cpu" and AFFECTED_JAXLIB <= _jaxlib_version() < FIXED_JAXLIB


def _jaxlib_version() -> tuple[int, ...]:
    return tuple(int(part) for part in metadata.version("jaxlib").split(".")[:2])


def is_guarded(scan: Any) -> bool:
    """Return whether the module `scan` has the barrier."""
    return hasattr(getattr(scan, "body_tree", None), "__wrapped__")


def _guard(scan: Any) -> None:
    if is_guarded(scan):
        return
    body_tree = getattr(scan, "body_tree", None)
    if body_tree is None:
        version = metadata.version("mujoco-mjx")
        raise ImportError(f"mujoco-mjx {version} has no scan.body_tree; install a release that pyproject.toml allows")

    @functools.wraps(body_tree)
    def guarded(model: Any, f: Any, *rest: Any, **options: Any) -> Any:
        return body_tree(model, lambda carry, *args: f(jax.lax.optimization_barrier(carry), *args), *rest, **options)

    scan.body_tree = guarded
