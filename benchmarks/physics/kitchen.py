"""Close and open the objects of the kitchen by waypoints of the mocap body: `python -m benchmarks.physics.kitchen`.

Prints one JSON line per script and writes results/kitchen/scripts.csv and .json.
"""

import json
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.output import RESULTS, save_rows
from earl_jax.envs import State, make
from earl_jax.envs.kitchen import reward as kitchen_reward
from earl_jax.envs.kitchen.franka_kitchen import REACH, FrankaKitchen

NEARLY = 0.03
"""Remaining distance (rad, m) at which a script's object counts as moved."""
BACK = 0.1
"""Position along y to which the hand withdraws, in metres."""
STEPS = 240


class Script(NamedTuple):
    """Waypoints [w, 3] of the mocap body, the index in a state of the object that it moves, and its start and goal."""

    waypoints: tuple[tuple[float, float, float], ...]
    index: int
    start: float
    goal: float


SCRIPTS = {
    "close microwave": Script(((-0.68, -0.1, 2.2), (-0.68, -0.1, 1.82), (-0.68, 0.34, 1.82)), 22, -0.7, 0.0),
    "close right hinge": Script(
        ((-0.2, 0.0, 2.1), (0.05, 0.0, 2.1), (0.05, 0.06, 2.55), (-0.3, 0.1, 2.55), (-0.42, 0.25, 2.55), (-0.42, 0.46, 2.55)),
        21, 1.45, 0.0,
    ),
    "close slide": Script(((0.0, 0.0, 2.2), (0.36, 0.1, 2.55), (0.36, 0.36, 2.55), (-0.14, 0.36, 2.55)), 19, 0.37, 0.0),
    "close light": Script(((-0.52, 0.2, 2.28), (-0.52, 0.38, 2.28), (-0.36, 0.38, 2.28)), 17, -0.69, 0.0),
    "open slide": Script(((-0.22, 0.1, 2.55), (-0.22, 0.36, 2.55), (0.36, 0.36, 2.55)), 19, 0.0, 0.37),
    "open light": Script(((-0.28, 0.2, 2.28), (-0.28, 0.38, 2.28), (-0.52, 0.38, 2.28)), 17, 0.0, -0.69),
    "turn burner": Script(
        ((-0.2, 0.2, 2.27), (-0.2, 0.39, 2.27), (-0.1, 0.39, 2.27), (-0.07, 0.39, 2.18)), 9, 0.0, -1.57,
    ),
    "open microwave": Script(
        ((-0.6, 0.0, 2.0), (-0.6, 0.0, 1.85), (-0.6, 0.33, 1.85), (-0.675, 0.33, 1.85), (-0.675, 0.05, 1.85), (-0.7, -0.1, 1.85)),
        22, 0.0, -0.7,
    ),
    "open right hinge": Script(
        ((-0.6, 0.1, 2.3), (-0.6, 0.1, 2.55), (-0.6, 0.39, 2.55), (-0.35, 0.39, 2.55), (0.1, 0.07, 2.55), (0.2, -0.03, 2.55)),
        21, 0.0, 1.45,
    ),
    "turn bottom burner": Script(
        ((-0.33, 0.2, 2.27), (-0.33, 0.4, 2.27), (-0.26, 0.4, 2.27), (-0.26, 0.4, 2.25)), 11, 0.0, -0.88,
    ),
}  # fmt: skip


def start_state(env: FrankaKitchen, script: Script) -> State:
    """Return a state after a reset in which all objects are closed, except that of `script`, which is at its start."""
    state = env.reset(jax.random.key(0))
    objects = jnp.zeros(len(kitchen_reward.FIRST) - kitchen_reward.ROBOT)
    objects = jnp.where(kitchen_reward.FIRST[kitchen_reward.ROBOT :] == script.index, script.start, objects)
    qpos = jnp.concatenate([state.data.qpos[: kitchen_reward.ROBOT], objects])
    return state.replace(data=state.data.replace(qpos=qpos))


def act(script: Script, state: State, stage: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return the action [9] and the number of the next waypoint; the hand withdraws along y when the object is moved."""
    waypoints, mocap = jnp.array(script.waypoints), state.data.mocap_pos[0]
    stage = jnp.where(
        jnp.linalg.norm(waypoints[stage] - mocap) < 2e-3, jnp.minimum(stage + 1, len(waypoints) - 1), stage
    )
    left = (script.goal - kitchen_reward.observed(state.data.qpos)[script.index]) * jnp.sign(script.goal - script.start)
    target = jnp.where(left < NEARLY, jnp.minimum(mocap, jnp.array([np.inf, BACK, np.inf])), waypoints[stage])
    return jnp.append(jnp.clip((target - mocap) / REACH, -1.0, 1.0), jnp.zeros(6)), stage


def play(env: FrankaKitchen, script: Script) -> tuple[jax.Array, State]:
    """Return the position [T] of the moved object after each step, without noise, and the last state."""

    def step(carry: tuple[State, jax.Array], _: None) -> tuple[tuple[State, jax.Array], jax.Array]:
        action, stage = act(script, *carry)
        state = env.step(carry[0], action)
        return (state, stage), kitchen_reward.observed(state.data.qpos)[script.index]

    first = (start_state(env, script), jnp.zeros((), jnp.int32))
    (state, _), moved = jax.lax.scan(step, first, length=STEPS)
    return moved, state


def play_all(env: FrankaKitchen) -> tuple[jax.Array, State]:
    """Return the positions [scripts, T] and the last states of `play` for all `SCRIPTS`, from one program."""
    longest = max(len(script.waypoints) for script in SCRIPTS.values())
    padded = [
        script._replace(waypoints=np.pad(script.waypoints, ((0, longest - len(script.waypoints)), (0, 0)), "edge"))
        for script in SCRIPTS.values()
    ]
    scripts = jax.tree.map(lambda *fields: np.stack(fields), *padded)
    return jax.jit(jax.vmap(lambda script: play(env, script)))(scripts)


def scripts() -> list[dict[str, Any]]:
    """Return one row per script, on engine c: the final position of its object, and the distance to its goal."""
    env, rows = make("franka_kitchen", engine="c"), []
    moved, states = play_all(env)
    faults = jax.vmap(env.fault)(states)
    for (name, script), positions, fault in zip(SCRIPTS.items(), moved, faults, strict=True):
        end = float(positions[-1])
        rows.append(
            {
                "script": name, "start": script.start, "goal": script.goal, "end": round(end, 4),
                "error": round(abs(end - script.goal), 4), "steps": STEPS, "fault": bool(fault),
            }
        )  # fmt: skip
        print(json.dumps(rows[-1]), flush=True)
    return rows


if __name__ == "__main__":
    save_rows(RESULTS / "kitchen" / "scripts", scripts())
