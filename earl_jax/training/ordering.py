"""Everything in a training step that exists for the order of operations in a compiled program; no value changes.

XLA orders operations by data dependencies alone, and merges what it can. Each function says what was measured without
it: kernels and copies of a step of FBRL with five lanes, by `python -m benchmarks.speed.kernels` for an H200, or the
temporary memory of a compiled program on a CPU.
"""

from typing import Any

import jax
import jax.numpy as jnp

from earl_jax.physics import PendingStep
from earl_jax.training.state import TrainState

UNLIKELY = -1.2345e38
"""A number that sums of a program's arrays never equal."""


def unfolded(tree: Any) -> Any:
    """Return the arrays of `tree`, into which the compiler cannot fold constants that are written there.

    Without it, the program of the first state contains the whole replay with its demonstrations: for 264 MB of replay, a
    process has 819 MB after the first state on a CPU, and 2 GB while it compiles.
    """
    return jax.tree.map(lambda leaf: jax.lax.optimization_barrier(leaf) if leaf.size else leaf, tree)


def in_step_with_host(pending: PendingStep, tree: Any) -> tuple[PendingStep, Any]:
    """Return `pending` and the `tree`, which are available only after each other, where the host simulates.

    The device learns before it waits for the host, and stores a step after it has started the next one. Between the
    host's answer and the next start, FBRL on the door has 22 kernels with it, 31 where the step is stored at once, and 45
    where the scan does not start ahead either.
    """
    if pending.ticket is None:
        return pending, tree
    ticket, tree = jax.lax.optimization_barrier((pending.ticket, tree))
    return pending._replace(ticket=ticket), tree


def read_before_write(state: TrainState, batch: Any) -> tuple[TrainState, Any]:
    """Return the `state`, whose replay the next write can use once the sampled `batch` is read, and that batch.

    The next row depends on every array by a comparison that is always false. Without it, XLA on a CPU copies the whole
    buffer twice in each step: 45 MB instead of 2 MB for 200,000 steps of tabletop.
    """
    batch = jax.lax.optimization_barrier(batch)
    is_unlikely = sum(leaf.ravel()[0].astype(jnp.float32) for leaf in jax.tree.leaves(batch)) == UNLIKELY
    return state.replace(replay=state.replay.replace(row=state.replay.row + is_unlikely)), batch


def before_update(tree: Any) -> Any:
    """Return parameters to act with, read before the update.

    Without it, XLA reads them in the kernels of the update: the longest chain of kernels that wait for each other is 43 on
    tabletop instead of 35.
    """
    return jax.lax.optimization_barrier(tree)


def one_controller(agent: Any, controllers: int) -> Any:
    """Return the updated agent of one of several controllers.

    Without it, XLA writes all controllers to new arrays and copies them back: 53 copies among 170 kernels on the door
    instead of 8 among 130.
    """
    return jax.lax.optimization_barrier(agent) if controllers > 1 else agent
