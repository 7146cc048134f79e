"""Continuing evaluation: what an agent earned while it lived, and how often somebody had to step in."""

import jax
import jax.numpy as jnp

from earl_jax.algos.autonomy import Lane


def continuing_lane(lane: Lane, step: jax.Array, since: jax.Array) -> tuple[Lane, dict[str, jax.Array]]:
    """Return one lane with its window closed, and its averages after `step` steps, `since` of them in the window.

    `continuing/reward` is the paper's metric: task reward averaged over the lifetime, whichever controller acted;
    `continuing/recent` the same since the last report; `interventions`, `faults` (those among them that a broken
    simulation enforced) and `reached` are counts since birth.
    """
    total = lane.tally.total_reward + lane.tally.window_reward
    metrics = {
        "continuing/reward": total / step,
        "continuing/recent": lane.tally.window_reward / since,
        "interventions": lane.tally.interventions,
        "faults": lane.tally.faults,
        "reached": lane.tally.reached,
    }
    closed = lane.tally.replace(total_reward=total, window_reward=jnp.zeros_like(total))
    return lane.replace(tally=closed), metrics
