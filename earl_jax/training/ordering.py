"""Functions that only control the order of operations in a compiled training step; they change no values.

XLA orders operations by data dependencies alone, and merges what it can. Each docstring says what was measured without
the function: kernels and copies in a step of FBRL with five lanes (`python -m benchmarks.speed.kernels` on an H200), or
the temporary memory of a compiled program on a CPU.
"""

from typing import Any

import jax
import jax.numpy as jnp

from earl_jax.physics import PendingStep
from earl_jax.training.state import TrainState

UNLIKELY = -1.2345e38
"""A number that sums of a program's arrays never equal in practice."""


def unfolded(tree: Any) -> Any:
    """Return the arrays of `tree` such that the compiler cannot fold the constants that are written into them.

    Otherwise the program that makes the first state contains the whole replay with its demonstrations: for a replay of
    264 MB, a process uses 819 MB after the first state on a CPU, and 2 GB while it compiles.
    """
    return jax.tree.map(lambda leaf: jax.lax.optimization_barrier(leaf) if leaf.size else leaf, tree)


def in_step_with_host(pending: PendingStep, tree: Any) -> tuple[PendingStep, Any]:
    """Return `pending` and `tree`, tied together if the host simulates: neither is available before the other.

    The device then learns before it waits for the host, and stores a step after it has started the next one. Between
    the host's answer and the next start, FBRL on the door runs 22 kernels; it runs 31 if the step is stored at once,
    and 45 if in addition the scan does not start steps ahead.
    """
    if pending.ticket is None:
        return pending, tree
    ticket, tree = jax.lax.optimization_barrier((pending.ticket, tree))
    return pending._replace(ticket=ticket), tree


def read_before_write(state: TrainState, batch: Any) -> tuple[TrainState, Any]:
    """Return the `state`, to whose replay nothing is written before the sampled `batch` was read, and the batch.

    The next row depends on every array through a comparison that is always false. Otherwise XLA on a CPU copies the
    whole buffer twice in each step: 45 MB instead of 2 MB for 200,000 steps of tabletop.
    """
    batch = jax.lax.optimization_barrier(batch)
    is_unlikely = sum(leaf.ravel()[0].astype(jnp.float32) for leaf in jax.tree.leaves(batch)) == UNLIKELY
    return state.replace(replay=state.replay.replace(row=state.replay.row + is_unlikely)), batch


def before_update(tree: Any) -> Any:
    """Return the parameters in `tree`, with which the agent acts, read before the update.

    Otherwise XLA reads them in the kernels of the update, and the longest chain of kernels that wait for each other has
    43 kernels on tabletop instead of 35.
    """
    return jax.lax.optimization_barrier(tree)


def one_controller(agent: Any, controllers: int) -> Any:
    """Return the updated agent of one of several controllers.

    Otherwise XLA writes all controllers to new arrays and copies them back: 53 copies among 170 kernels on the door
    instead of 8 among 130.
    """
    return jax.lax.optimization_barrier(agent) if controllers > 1 else agent
