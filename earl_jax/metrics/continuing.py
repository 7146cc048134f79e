"""Continuing evaluation: what an agent earned while it lived, and how often somebody had to step in."""

import jax
import jax.numpy as jnp

from earl_jax.algos.life import Lane
from earl_jax.envs import State


def continuing_lane(lane: Lane, step: jax.Array, since: jax.Array) -> tuple[Lane, dict[str, jax.Array]]:
    """Return one lane with its window closed, and its averages after `step` steps, `since` of them in the window.

    `continuing/reward` is the paper's metric: task reward averaged over the lifetime, whichever controller acted;
    `continuing/recent` the same since the last report; `interventions`, `faults` (those among them that a broken
    simulation enforced) and `reached` are counts since birth. In a world with help (`Helped`) `help/asked` and
    `help/enforced` count its own interventions, `help/budget` is what is left, and `help/over` whether that ended the life.
    """
    total = lane.tally.total_reward + lane.tally.window_reward
    metrics = {
        "continuing/reward": total / step,
        "continuing/recent": lane.tally.window_reward / since,
        "interventions": lane.tally.interventions,
        "faults": lane.tally.faults,
        "reached": lane.tally.reached,
    }
    if isinstance(lane.world.data, State):
        info = lane.world.info
        metrics |= {f"help/{name}": info[name] for name in ("asked", "enforced", "budget")}
        metrics["help/over"] = lane.world.done
    closed = lane.tally.replace(total_reward=total, window_reward=jnp.zeros_like(total))
    return lane.replace(tally=closed), metrics
