"""Where lives of the shipped CFBRL policy on the peg end: `python -m benchmarks.peg_lives` (minutes on two cores).

The greedy policy lives LANES lives of STEPS steps from s0 without learning, exploration or resets. Task goal and a random
initial state alternate as goals; a phase ends at success or after H_E steps. Writes results/cfbrl/peg_lives.csv: phases of
each lane that ended and that reached their goal, the step of the last success, and where hand and peg are at the end.
"""

import argparse
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import earl_jax
from earl_jax.envs import Env, State
from earl_jax.envs.sawyer.base import GRIPPER
from earl_jax.envs.sawyer.peg import SawyerPeg
from earl_jax.report.tables import write

RESULT = Path(__file__).parent / "results" / "cfbrl" / "peg_lives.csv"
LANES, STEPS = 12, 20_000
OPEN = 0.9
"""Reading of the gripper from which it is open."""
NEAR = 0.08
"""Metres between hand and peg within which a closed hand may hold it."""
LENGTH = 0.2
"""Metres of the peg behind its head that a hand can hold."""


def live(env: Env, policy: Callable, key: jax.Array) -> tuple[State, jax.Array]:
    """Return the last state of one life, and for each step whether a phase ended and whether it succeeded, [STEPS, 2]."""
    tasks, initials = jnp.asarray(env.goal_states), jnp.asarray(env.initial_states)

    def step(carry, step_key):
        state, back, age = carry
        state = env.step(state, policy(state.obs))
        reached = env.success(state.obs)
        over = reached | (age + 1 >= env.eval_horizon)
        back = jnp.where(over, ~back, back)
        drawn = initials[jax.random.randint(step_key, (), 0, len(initials))]
        goal = jnp.where(over, jnp.where(back, drawn, tasks[0]), state.info["goal"])
        return (env.with_goal(state, goal), back, jnp.where(over, 0, age + 1)), jnp.stack([over, reached])

    start = env.with_goal(env.reset(key), tasks[0])
    first = (start, jnp.zeros((), bool), jnp.zeros((), jnp.int32))
    (state, _, _), ends = jax.lax.scan(step, first, jax.random.split(key, STEPS))
    return state, ends


def row(lane: int, obs: np.ndarray, ends: np.ndarray) -> dict:
    """Return what there is to say about one life with the last observation `obs [14]`."""
    hand, head = obs[:3], obs[4:7]
    reached = np.flatnonzero(ends[:, 1])
    held = head + np.array([np.clip(hand[0] - head[0], 0.0, LENGTH), 0.0, 0.0])
    closed, far = obs[GRIPPER] < OPEN, np.linalg.norm(hand - held) > NEAR
    return {
        "lane": lane,
        "phases": int(ends[:, 0].sum()),
        "reached": len(reached),
        "last_success": int(reached[-1]) + 1 if len(reached) else 0,
        "hand": " ".join(f"{value:.2f}" for value in hand),
        "gripper": round(float(obs[GRIPPER]), 2),
        "peg_head": " ".join(f"{value:.2f}" for value in head),
        "empty_closed_hand": bool(closed and far),
    }


def main() -> None:
    """Live and write a row for each lane, or print the share of goals that the script reaches."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--expert", action="store_true", help="live as the task's script does, and write nothing")
    expert = parser.parse_args().expert
    env = SawyerPeg(engine="c").for_lanes(LANES)
    policy = env.expert if expert else earl_jax.pretrained("sawyer_peg", "cfbrl")
    keys = jax.random.split(jax.random.key(0), LANES)
    states, ends = jax.jit(jax.vmap(lambda key: live(env, policy, key)))(keys)
    if expert:
        print(f"reached {int(ends[..., 1].sum())} of {int(ends[..., 0].sum())} goals in {LANES} lives of {STEPS} steps")
        return
    rows = [row(lane, *lives) for lane, lives in enumerate(zip(np.asarray(states.obs), np.asarray(ends), strict=True))]
    write(rows, RESULT)
    print(*rows, sep="\n")


if __name__ == "__main__":
    main()
