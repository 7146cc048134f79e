"""Work around one slow compilation of MuJoCo MJX: the only place that touches its private modules.

XLA's CPU compiler fuses MJX's walk along a chain of bodies into itself and recomputes every parent in each child. The cost is
exponential in the length of the chain: 248 ms instead of 0.4 ms for one step of the Sawyer arm. An optimization barrier on the
walk's carry prevents the fusion and does not change a value.
"""

import functools
import importlib
from importlib import metadata
from typing import Any

import jax

AFFECTED_JAXLIB = (0, 10)
"""The first release of jaxlib with the slow fusion. No later release is known to be free of it."""


def guard_kinematics() -> bool:
    """Put a barrier into MJX's `scan.body_tree` once, where this process needs it, and return whether it is there.

    Raises:
        ImportError: MJX has no `scan.body_tree` any more; the message names its version.
    """
    if jax.default_backend() != "cpu" or _jaxlib_version() < AFFECTED_JAXLIB:
        return False
    _guard(importlib.import_module("mujoco.mjx._src.scan"))
    return True


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
