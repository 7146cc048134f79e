"""What happens inside a lifetime: whether phases of both directions reach their goals, and whether the object moves.

These metrics are ours; docs/formalism.md says why deployed success alone does not show this.
"""

import jax
import jax.numpy as jnp
from flax import struct

from earl_jax.envs import Env, State

FORWARD, BACK = "continuing/forward_success", "continuing/back_success"
ALIVE, STILL = "continuing/alive", "continuing/still_steps"
MOVED = 0.01
"""Distance of the object from where it lay that counts as a movement: metres, radians or table units."""


class PhaseStats(struct.PyTreeNode):
    """Counts of one lane: [2] is the task phase and the others, int32; steps are counted from 1.

    `ended [2]`, `reached [2]`: phases with a goal that have ended, and how many of them reached it; `counted [2, 2]`:
    both numbers at the last evaluation; `reached_at [2]`: the last step at such a goal, initially the start; `moved_at
    []`: the step at which the object last moved; `rest [k]`, float32: its position then, None without an object.
    """

    ended: jax.Array
    reached: jax.Array
    counted: jax.Array
    reached_at: jax.Array
    moved_at: jax.Array
    rest: jax.Array | None


def init_phase_stats(env: Env, env_state: State) -> PhaseStats:
    """Return the counts of a lane that starts in `env_state`."""
    none = jnp.zeros(2, jnp.int32)
    rest = env.object_position(env_state) if env.object_position else None
    return PhaseStats(none, none, jnp.zeros((2, 2), jnp.int32), none, jnp.zeros((), jnp.int32), rest)


def advance_phase_stats(
    stats: PhaseStats,
    env: Env,
    env_state: State,
    is_task: jax.Array,
    phase_ended: jax.Array,
    at_goal: jax.Array | bool,
    step: jax.Array,
    age: jax.Array | int = 0,
) -> PhaseStats:
    """Return the counts after step number `step`, counted from 1, which led to `env_state`; bool scalars.

    `is_task`: the step is in the task phase; `phase_ended`: it ended a phase with a goal; `at_goal`: `env_state` is at
    that goal. A phase reached its goal if any of its steps was at it; `age []` is the number of its earlier steps.
    """
    phase = jnp.stack([is_task, ~is_task])
    ends, reached_at = phase & phase_ended, jnp.where(phase & at_goal, step, stats.reached_at)
    stats = stats.replace(
        ended=stats.ended + ends,
        reached=stats.reached + (ends & (reached_at >= step - age)),
        reached_at=reached_at,
    )
    if env.object_position is None or stats.rest is None:
        return stats
    position = env.object_position(env_state)
    moved = jnp.square(position - stats.rest).sum() > MOVED**2
    return stats.replace(moved_at=jnp.where(moved, step, stats.moved_at), rest=jnp.where(moved, position, stats.rest))


def phase_metrics(
    stats: PhaseStats, step: jax.Array, alive_steps: int, phases: int, sparse: bool
) -> tuple[PhaseStats, dict[str, jax.Array]]:
    """Return the counts with a new window, and one lane's metrics after `step` steps.

    `continuing/forward_success` and `continuing/back_success` are the shares of the phases ended since the last
    evaluation that reached their goal; nan if none ended. `continuing/alive` is 1 if both directions have reached a
    goal within the last `alive_steps` steps, or since the start if that is later, else 0; a direction in which no phase
    with a goal has ended yet does not count. `continuing/still_steps` is the number of steps since the object last
    moved by a centimetre (`MOVED`), which an intervention can also cause.

    Tasks with a dense reward have no goals to reach, and methods with one phase have no return phase; they have only
    the columns that make sense for them.
    """
    counts = jnp.stack([stats.ended, stats.reached])
    ended, reached = counts - stats.counted
    shares = jnp.where(ended > 0, reached / jnp.maximum(ended, 1), jnp.nan)
    alive = ((step - stats.reached_at <= alive_steps) | (stats.ended == 0)).all()
    metrics = {FORWARD: shares[0], BACK: shares[1], ALIVE: alive.astype(jnp.int32)} if sparse else {}
    if phases == 1:
        metrics.pop(BACK, None)
    if stats.rest is not None:
        metrics[STILL] = step - stats.moved_at
    return stats.replace(counted=counts), metrics
