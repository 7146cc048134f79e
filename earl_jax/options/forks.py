"""Processes that were forked after jax had started: in them, jax waits forever for threads that only the parent has.

The package imports this module when it is imported itself, before a user can fork. This module does not load jax.
"""

import os
import sys

from earl_jax.errors import InputError

_after_jax = False


def _note_fork() -> None:
    """Note whether jax has started; this stays unknown in a release of jax without the function that tells."""
    global _after_jax
    bridge = sys.modules.get("jax._src.xla_bridge")
    _after_jax = getattr(bridge, "backends_are_initialized", bool)()


if hasattr(os, "register_at_fork"):  # Windows has no forks
    os.register_at_fork(after_in_child=_note_fork)


def require_jax() -> None:
    """Check that jax can compute in this process.

    Raises:
        ValueError: this process was forked after jax had started.
    """
    if _after_jax:
        raise InputError(
            "this process was forked after jax had started, and jax cannot compute in it; start it by "
            "multiprocessing.get_context('spawn') instead, or before the parent's first use of jax"
        )
