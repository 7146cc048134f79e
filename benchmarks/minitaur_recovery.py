"""Measure how often a fallen Minitaur gets up: `python -m benchmarks.minitaur_recovery --lanes 96 --out FILE.json`.

The robot starts on its back or on a side, rests for a second, and then moves for ten. A third of the lanes each apply uniform
actions, random corners of the action box, and corners held for up to half a second, which throw the robot about. A body is
upright if its axis is within 37 degrees of the vertical (cosine 0.8). Prints one JSON line.
"""

import argparse
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.output import emit
from benchmarks.safety import make_actions
from earl_jax.envs import make

POSES = {
    "back": (0.0, 1.0, 0.0, 0.0),
    "left side": (0.7071, -0.7071, 0.0, 0.0),
    "right side": (0.7071, 0.7071, 0.0, 0.0),
}
HEIGHT = {"back": 0.12, "left side": 0.2, "right side": 0.2}
SETTLE, MOVE = 100, 1000
UPRIGHT = 0.8


def cosine(qpos: jax.Array) -> jax.Array:
    """Return the cosine [...] between the body's axis and the vertical for `qpos [..., 23]`."""
    return 1.0 - 2.0 * (qpos[..., 4] ** 2 + qpos[..., 5] ** 2)


def tilts(pose: str, actions: np.ndarray) -> np.ndarray:
    """Return the cosines [SETTLE + steps, lanes] of robots that start in `pose`, first at rest, then under `actions`."""
    env, lanes = make("minitaur_pen"), actions.shape[1]
    state = jax.vmap(env.reset)(jax.random.split(jax.random.key(0), lanes))
    qpos = state.data.qpos.at[:, 2].set(HEIGHT[pose]).at[:, 3:7].set(jnp.array(POSES[pose]))
    state = state.replace(data=state.data.replace(qpos=qpos, qvel=jnp.zeros_like(state.data.qvel)))
    moves = np.concatenate([np.zeros((SETTLE, *actions.shape[1:]), np.float32), actions])

    def step(state, action):
        state = jax.vmap(env.step)(state, action)
        return state, cosine(state.data.qpos)

    return np.asarray(jax.jit(lambda s, a: jax.lax.scan(step, s, a)[1])(state, jnp.asarray(moves)))


def report(lanes: int) -> dict[str, Any]:
    """Return, for each pose, the shares of robots that are upright after a second of rest, at some time after, and at the end."""
    actions, poses = make_actions(MOVE, lanes, 8), {}
    for pose in POSES:
        cosines = tilts(pose, actions)
        moved = cosines[SETTLE:]
        poses[pose] = {
            "upright_after_rest": float((cosines[SETTLE - 1] > UPRIGHT).mean()),
            "upright_at_some_time": float((moved > UPRIGHT).any(axis=0).mean()),
            "upright_at_the_end": float((moved[-1] > UPRIGHT).mean()),
            "largest_cosine_from_lying": round(float(moved[:, cosines[SETTLE - 1] < UPRIGHT].max(initial=-1.0)), 4),
        }
    return {"env": "minitaur_pen", "lanes": lanes, "seconds": MOVE / 100, "poses": poses}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lanes", type=int, default=96)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    command = f"python -m benchmarks.minitaur_recovery --lanes {arguments.lanes}"
    emit(report(arguments.lanes), arguments.out, command)


if __name__ == "__main__":
    main()
