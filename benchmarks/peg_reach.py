"""Where the hand can grasp the peg among its 22 far starts: `python -m benchmarks.peg_reach` (a minute on two cores).

From each start the hand goes up, goes above the peg's grasp point, goes straight down, closes and goes up again. Writes
results/cloning/peg_reach.csv: how far the hand stays from the grasp point, and how high the peg's head is in the end.
"""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.envs import State
from earl_jax.envs.sawyer.base import REACH
from earl_jax.envs.sawyer.experts import GRASP
from earl_jax.envs.sawyer.peg import FAR_HEADS, LOW, SawyerPeg
from earl_jax.report.tables import write

RESULT = Path(__file__).parent / "results" / "cloning" / "peg_reach.csv"
HIGH, GRASP_HEIGHT = 0.25, 0.05
RISEN, ABOVE, DOWN, CLOSED, END = 60, 200, 300, 330, 420
"""Control steps at which the parts of the movement end."""
LIFTED = 0.1
"""Height [m] of the head from which a peg counts as lifted."""


def attempt(env: SawyerPeg, head: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return the states [7] before the gripper closes and at the end, with the peg's `head [2]` at the start."""
    lying = jnp.append(head, LOW[2])
    grasp = (lying + jnp.asarray(GRASP))[:2]

    def step(state: State, number: jax.Array) -> tuple[State, jax.Array]:
        across = jnp.where(number < RISEN, state.obs[:2], grasp)
        low = (number >= ABOVE) & (number < CLOSED)
        waypoint = jnp.append(across, jnp.where(low, GRASP_HEIGHT, HIGH))
        move = jnp.clip((waypoint - state.data.mocap_pos[0]) / REACH, -1.0, 1.0)
        state = env.step(state, jnp.append(move, jnp.where(number < DOWN, -1.0, 1.0)))
        return state, state.obs[:7]

    start = env.state_from_demo(jnp.concatenate([jnp.zeros(4), lying]), jnp.asarray(env.goal_states)[0])
    states = jax.lax.scan(step, start, jnp.arange(END))[1]
    return states[DOWN - 1], states[-1]


def main() -> None:
    """Write a row for each far start."""
    env = SawyerPeg(engine="c")
    before, after = map(np.asarray, jax.jit(jax.vmap(lambda head: attempt(env, head)))(jnp.asarray(FAR_HEADS)))
    short = np.linalg.norm(before[:, :2] - (FAR_HEADS + GRASP[:2]), axis=1)
    rows = [
        {
            "x": round(float(head[0]), 2),
            "y": round(float(head[1]), 2),
            "hand_short_of_grasp_m": round(float(distance), 3),
            "head_height_m": round(float(end[6]), 3),
            "lifted": bool(end[6] > LIFTED),
        }
        for head, distance, end in zip(FAR_HEADS, short, after, strict=True)
    ]
    write(rows, RESULT)
    print(f"lifted from {sum(row['lifted'] for row in rows)} of {len(rows)} starts")


if __name__ == "__main__":
    main()
